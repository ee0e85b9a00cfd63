"""Commands that act late: dead time and first-order lag.

An engine takes one command for a whole control period. What acts within it is not constant, so
its mean over the period is what the engine is given.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.delay import SHORTEST_LAG, dead_time, rows_back, taps


class DeadTime(RememberingCommand):
    """The command waits for a time that need not be whole periods.

    The commands are a staircase; late by n + s periods its mean over one is
    (1 - s) u_{k-n} + s u_{k-n-1}.
    """

    equation = "u'(t) = u(t - dead_time)"

    @property
    def size(self) -> int:
        return self._rows_back

    def _values_changed(self) -> None:
        self._rows_back = rows_back(self.values["dead_time"], self.dt)
        whole, share = taps(self._here("dead_time"), self.dt, self._rows_back)
        self._keep(whole=whole, share=share)

    def _moved(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        rows = torch.cat([command.unsqueeze(-1), state], -1)  # (n, K + 1), newest first
        index = self._kept("whole").expand(command.shape).unsqueeze(-1)
        newer = rows.gather(-1, index).squeeze(-1)
        older = rows.gather(-1, index + 1).squeeze(-1)
        return newer + self._kept("share") * (older - newer), rows[..., :-1]


class Lag(RememberingCommand):
    """A first-order lag, solved exactly for a command that stands still for a period.

    y_{k+1} = u + (y_k - u) e,  e = exp(-dt / T), and its mean over the period is
    u + (y_k - u) (1 - e) T / dt.
    """

    equation = "time_constant du'/dt = u - u'"
    lasting = True

    def _values_changed(self) -> None:
        lag = self._here("time_constant").clamp_min(SHORTEST_LAG)
        passed = -torch.expm1(-self.dt / lag)
        self._keep(left=1 - passed, mean_left=passed * lag / self.dt)

    def _moved(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        behind = state.squeeze(-1) - command
        end = command + behind * self._kept("left")
        return command + behind * self._kept("mean_left"), end.unsqueeze(-1)


class ThrottleDeadTime(DeadTime):
    """The throttle is heard late."""

    name = "throttle_dead_time"
    channel = 0
    declared = dead_time("Delay until the throttle is heard.")

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the throttle takes effect {1000 * values['dead_time']:.3g} ms late"


class SteeringDeadTime(DeadTime):
    """The steering is heard late."""

    name = "steering_dead_time"
    channel = 1
    declared = dead_time("Delay until the steering is heard.")

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the steering takes effect {1000 * values['dead_time']:.3g} ms late"


class ThrottleLag(Lag):
    """The throttle builds up gradually."""

    name = "throttle_lag"
    channel = 0
    declared = (
        EffectParameter(
            "time_constant", 0.0, 0.0, 1.0, "s", "Time in which 63 % has come.", 0.08, 0.01
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lag = 1000 * values["time_constant"]
        return f"the throttle builds up gradually: 63 % of a change is there after {lag:.3g} ms"


class SteeringLag(Lag):
    """The wheels turn gradually."""

    name = "steering_lag"
    channel = 1
    declared = (
        EffectParameter(
            "time_constant", 0.0, 0.0, 1.0, "s", "Time in which 63 % has come.", 0.08, 0.01
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lag = 1000 * values["time_constant"]
        return f"the wheels turn gradually: 63 % of a change is there after {lag:.3g} ms"
