"""A sensor that measures with a dead time or a first-order lag.

Both stand nearer to the engine than the sensor's other effects, with which they commute to first
order.
"""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.core.vehicle import rotate
from buggy_rl.effects.base import numbers_spec
from buggy_rl.effects.delay import (
    LAG_SOURCE,
    DeadTimeEffect,
    dead_time,
    lag_decay,
    rows_back,
    taps,
    time_constant,
)
from buggy_rl.effects.sensing.base import SensingEffect, sensed_motion

SAME = 1e-4  # [rows] of a dead time that are rounding
SMOOTHING = 0.05  # [s] to each side of a slope in `_true_motion`: 0.1 s in all; chosen


class SensorLatency(DeadTimeEffect, SensingEffect):
    """Measurement with a dead time, linear between rows.

    The memory [rows, 6] holds the poses and velocities before the present ones, newest first. After
    a reset they are those of a car that came there at constant velocity.
    """

    name = "sensor_latency"
    look_at = "Check clocks and delay of the tracker: when is a measurement stamped?"
    declared = dead_time(0.03, (0.0, 0.1))
    equation = "z(t) = (pose, velocity)(t - dead_time)"

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the sensor shows what was {1000 * values['dead_time']:.3g} ms ago"

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        if self.active and keys.MEASURED_POSE in set(observation_spec.keys()):
            raise ValueError(
                f"effect {self.name!r} comes too late: {keys.MEASURED_POSE} is already written; "
                "put it nearer to the engine than the other effects of the sensor"
            )
        return super().transform_observation_spec(observation_spec)

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        pose, velocity = state.get(keys.POSE), state.get(keys.VELOCITY)
        past = given.get(self.memory, None)  # (*, K, 6) of an episode that goes on
        if past is None:
            past = extrapolated(pose, velocity, self._rows_back, -self.dt)
        state.set(self.memory, past)
        self._write_measurement(state, self._gather(past, 2))

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        # The state before the step as it is now: its pose may have been edited since.
        last = torch.cat([before.get(keys.POSE), before.get(keys.VELOCITY)], -1)
        memory = before.get(self.memory)
        rows = self._gather(memory, 2)[..., :-1, :]
        past = torch.cat([self._gather(last).unsqueeze(-2), rows], -2)
        after.set(self.memory, self._scatter(memory, past, 2))
        self._write_measurement(after, past)

    def _write_measurement(self, td: TensorDictBase, past: Tensor) -> None:
        """Writes the measurement; `past` [n, K, 6] newest first."""
        pose, velocity = td.get(keys.POSE), td.get(keys.VELOCITY)
        present = torch.cat([self._gather(pose), self._gather(velocity)], -1).unsqueeze(-2)
        rows = torch.cat([present, past], -2)  # (n, K + 1, 6)
        index = self._tensor("whole").expand(rows.shape[:-2])
        late = _interpolated(rows, index.unsqueeze(-1), self._tensor("share")).squeeze(-2)
        self._set_measured(td, (pose, velocity), late.split(3, -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, self._rows_back, 6, device=device)}

    def rows_late(self, dt: float) -> Tensor:
        rows = torch.ceil(self.values["dead_time"] / dt - SAME).long()
        return rows.clamp_min(0)

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        dead_time = self._value("dead_time")
        most = rows_back(dead_time, dt)
        whole, share = taps(dead_time, dt, most)
        beyond = extrapolated(pose[..., -1, :], velocity[..., -1, :], most, dt)
        rows = torch.cat([torch.cat([pose, velocity], -1), beyond], -2)  # (*, T + K, 6)
        index = torch.arange(pose.shape[-2], device=pose.device) + whole.unsqueeze(-1)
        index = index.expand(pose.shape[:-1])
        then = _interpolated(rows, index, share.unsqueeze(-1) if share.dim() else share)
        return then[..., :3], then[..., 3:]


class SensorLag(SensingEffect):
    """Measurement through a first-order lag.

    Exact for motion that is linear over a step: with e = exp(-dt / T) and q = (1 - e) T / dt,
    z' = x' + (q - e) (x - x') + e (z - x'). The memory [12] is z and x; after a reset z is that of
    a car that came there at constant velocity.
    """

    name = "sensor_lag"
    look_at = "Check filters on the tracker's pose and velocity."
    equation = "time_constant dz/dt = (pose, velocity) - z"
    source = LAG_SOURCE
    declared = time_constant(0.03, (0.0, 0.1))

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lag = 1000 * values["time_constant"]
        return f"the sensor smooths what it shows, and shows it {lag:.3g} ms late"

    def _values_changed(self) -> None:
        end, mean = (x.unsqueeze(-1) for x in lag_decay(self._value("time_constant"), self.dt))
        self._store(decay=end, last=mean - end)

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        pose, velocity = sensed_motion(state)
        memory = given.get(self.memory, None)  # of an episode that goes on
        if memory is None:
            memory = self._steady(pose, velocity)
        state.set(self.memory, memory)
        shown = self._gather(memory)[..., :6]
        self._set_measured(state, (pose, velocity), shown.split(3, -1))

    def _steady(self, pose: Tensor, velocity: Tensor) -> Tensor:
        """Memory [*, 12] of a car that came here at constant velocity."""
        lag = self.values["time_constant"].unsqueeze(-1)
        planar = rotate(velocity[..., :2], pose[..., 2])
        trailing = pose - lag * torch.cat([planar, velocity[..., 2:]], -1)
        return torch.cat([trailing, velocity, pose, velocity], -1)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        pose, velocity = sensed_motion(after)
        memory = before.get(self.memory)
        shown, previous = self._gather(memory).split(6, -1)
        now = torch.cat([self._gather(pose), self._gather(velocity)], -1)
        decay, last = self._tensor("decay"), self._tensor("last")
        shown = now + last * (previous - now) + decay * (shown - now)
        after.set(self.memory, self._scatter(memory, torch.cat([shown, now], -1)))
        self._set_measured(after, (pose, velocity), shown.split(3, -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, 12, device=device)}

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        lag = self._over_time("time_constant").unsqueeze(-1)
        return pose + lag * rate(pose, dt), velocity + lag * rate(velocity, dt)


def extrapolated(pose: Tensor, velocity: Tensor, rows: int, dt: float) -> Tensor:
    """Pose and velocity [*, rows, 6] of a car at constant velocity, the first one a step away.

    Args:
        pose: [*, 3]
        velocity: [*, 3]
        rows: How many.
        dt: Step [s]; negative into the past.
    """
    count = torch.arange(1, rows + 1, device=pose.device)
    turn = dt * velocity[..., 2:]  # (*, 1)
    yaw = pose[..., 2:] + turn * count  # (*, rows)
    steps = rotate(dt * velocity[..., None, :2].expand(*yaw.shape, 2), yaw - 0.5 * turn)
    position = pose[..., None, :2] + steps.cumsum(-2)
    there = torch.cat([position, yaw.unsqueeze(-1)], -1)  # (*, rows, 3)
    return torch.cat([there, velocity.unsqueeze(-2).expand_as(there)], -1)


def _interpolated(rows: Tensor, index: Tensor, share: Tensor) -> Tensor:
    """Rows [*, R, 6] at indices [*, T], moved by a share [*, 1] or () towards the next row."""
    index = index.unsqueeze(-1).expand(*index.shape, rows.shape[-1])
    first, second = rows.gather(-2, index), rows.gather(-2, index + 1)
    weight = share.reshape(*share.shape, *(1,) * (first.dim() - share.dim()))
    return first + weight * (second - first)


def rate(recording: Tensor, dt: float) -> Tensor:
    """Time derivative [*, T, n] of a recording: slope of the straight line fitted around each row.

    Beyond its first and last row the recording is continued point-symmetrically about that row.
    """
    reach = min(max(1, round(SMOOTHING / dt)), recording.shape[-2] - 1)
    if reach < 1:
        return torch.zeros_like(recording)
    first, last = recording[..., :1, :], recording[..., -1:, :]
    before = 2 * first - recording[..., 1 : reach + 1, :].flip(-2)
    after = 2 * last - recording[..., -reach - 1 : -1, :].flip(-2)
    windows = torch.cat([before, recording, after], -2).unfold(-2, 2 * reach + 1, 1)
    place = torch.arange(-reach, reach + 1, device=recording.device, dtype=recording.dtype)
    return (windows * place).sum(-1) / (place.square().sum() * dt)
