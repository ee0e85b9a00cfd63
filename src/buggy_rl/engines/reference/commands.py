"""The radio, with its trims and dead times, and the lag of a controller."""

import math

import torch
from torch import Tensor

from buggy_rl.engines.reference.faults import Faults

ATTACK = 0.15  # [-] share of a lag's time constant that its faster pole has; chosen
SHORTEST = 1e-6  # [s] stands for no lag, where the formula divides by the time constant


class Radio:
    """Throttle and steering with trims and dead times.

    A command k periods old holds over [-k dt, -k dt + dt]. With a dead time tau, the command of a
    substep is the mean over its own time less tau: exact, and continuous in tau.

    Args:
        faults: Trims and dead times.
        dt: Control period [s].
        substeps: In a control period.
    """

    def __init__(self, faults: Faults, dt: float, substeps: int) -> None:
        self.trimmed = "throttle_offset" in faults or "steering_offset" in faults
        self.late = "throttle_dead_time" in faults or "steering_dead_time" in faults
        self.trim = torch.stack(
            torch.broadcast_tensors(
                faults["throttle_offset.offset"], faults["steering_offset.offset"]
            )
        )  # (2, *)
        self.dead_time = torch.stack(
            torch.broadcast_tensors(
                faults["throttle_dead_time.dead_time"], faults["steering_dead_time.dead_time"]
            )
        )
        self.kept = math.ceil(float(self.dead_time.max()) / dt - 1e-6) if self.late else 0
        self.weights = self._weights(dt, substeps) if self.late else None

    def received(self, line: Tensor | None, action: Tensor) -> tuple[Tensor, Tensor | None]:
        """Commands of each substep.

        Args:
            line: [*, K, 2] commands of the last periods, newest first; None without a dead time.
            action: [*, 2] of this period.

        Returns:
            Commands [S, 2, *], of one row for all substeps without a dead time, and the line one
            period later.
        """
        command = action.movedim(-1, 0)
        if self.trimmed:  # to the ends of the channel
            command = (command + self.trim).clamp(-1.0, 1.0)
        if line is None or self.weights is None:
            return command.unsqueeze(0), line
        given = torch.cat([command.unsqueeze(0), line.movedim((-2, -1), (0, 1))])  # (K + 1, 2, *)
        arriving = (self.weights * given).sum(1)  # (S, 2, *)
        line = given[:-1].movedim((0, 1), (-2, -1)).contiguous()
        return torch.where(self.dead_time > 0, arriving, command), line

    def _weights(self, dt: float, substeps: int) -> Tensor:
        """Weights [S, K + 1, 2, *] of the commands in those of the substeps."""
        shape = (-1, *[1] * (self.dead_time.dim() + 1))
        begin = torch.arange(substeps, dtype=torch.float64) * (dt / substeps)
        begin = begin.reshape(shape).to(self.dead_time.device) - self.dead_time.double()
        given = -dt * torch.arange(self.kept + 1, dtype=torch.float64, device=begin.device)
        given = given.reshape(shape[:-1])  # (K + 1, 1, *1)
        overlap = torch.minimum(begin + dt / substeps, given + dt) - torch.maximum(begin, given)
        return (overlap.clamp_min(0.0) * (substeps / dt)).to(self.dead_time)


class Lag:
    """A second-order lag without overshoot.

    Two first-order lags in series, of 85 % and 15 % of the time constant: its mean delay is that
    of one first-order lag, but its response begins with slope 0.

    Args:
        time_constant: [*] [s]; 0 is no lag.
        dt: Step [s].
    """

    def __init__(self, time_constant: Tensor, dt: float) -> None:
        self.none = time_constant <= 0
        slow = ((1.0 - ATTACK) * time_constant).clamp_min(SHORTEST)
        fast = (ATTACK * time_constant).clamp_min(SHORTEST)
        self.slow, self.fast = -torch.expm1(-dt / slow), -torch.expm1(-dt / fast)

    def moved(self, state: Tensor, target: Tensor) -> Tensor:
        """State [2, *] after a step towards a target [*]; its last row is the output."""
        first, second = state
        first = first + self.slow * (target - first)
        # The mean of the first over the step, so that the second is not half a step early.
        second = second + self.fast * (0.5 * (state[0] + first) - second)
        first = torch.where(self.none, target, first)
        return torch.stack([first, torch.where(self.none, target, second)])
