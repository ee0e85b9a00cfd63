"""A sensor that shows the motion late.

Both stand nearer to the engine than what else the sensor does, and commute with it but for
corrections of second order.
"""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.base import EffectParameter, numbers_spec
from buggy_rl.effects.delay import SHORTEST_LAG, dead_time, rows_back, taps
from buggy_rl.effects.sensing.base import SensingEffect, measured
from buggy_rl.effects.sensing.mounting import over_time
from buggy_rl.vehicle import rotate

SMOOTHING = 5  # rows to each side of a slope in `unsensed`: 0.1 s in all, chosen


class SensorLatency(SensingEffect):
    """What is shown is some time old, linear between rows.

    The memory [rows, 6] holds the poses and velocities before the present ones, newest first. At a
    reset they are those of a car that came there at constant velocity.
    """

    name = "sensor_latency"
    equation = "z(t) = (pose, velocity)(t - dead_time)"
    declared = dead_time("Age of what the sensor shows.")

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the sensor shows what was {1000 * values['dead_time']:.3g} ms ago"

    def _values_changed(self) -> None:
        self._rows_back = rows_back(self.values["dead_time"], self.dt)
        whole, share = taps(self._here("dead_time"), self.dt, self._rows_back)
        self._keep(whole=whole, share=share)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        if self.active and keys.MEASURED_POSE in set(observation_spec.keys()):
            raise ValueError(
                f"effect {self.name!r} comes too late: {keys.MEASURED_POSE} is already written; "
                "put it nearer to the engine than what else acts on the sensor"
            )
        return super().transform_observation_spec(observation_spec)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if not self.active:
            return tensordict_reset
        pose, velocity = tensordict_reset.get(keys.POSE), tensordict_reset.get(keys.VELOCITY)
        past = steady(pose, velocity, self._rows_back, -self.dt)  # (*, K, 6)
        tensordict_reset.set(self.memory, past)
        return self._shown(tensordict_reset, self._take(past, 2))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return next_tensordict
        # Where the last step ended, as it is now: somebody may have put the car elsewhere.
        last = torch.cat([tensordict.get(keys.POSE), tensordict.get(keys.VELOCITY)], -1)
        memory = tensordict.get(self.memory)
        past = torch.cat([self._take(last).unsqueeze(-2), self._take(memory, 2)[..., :-1, :]], -2)
        next_tensordict.set(self.memory, self._put(memory, past, 2))
        return self._shown(next_tensordict, past)

    def _shown(self, td: TensorDictBase, past: Tensor) -> TensorDictBase:
        """Writes what is measured; `past` [n, K, 6] newest first."""
        pose, velocity = td.get(keys.POSE), td.get(keys.VELOCITY)
        present = torch.cat([self._take(pose), self._take(velocity)], -1).unsqueeze(-2)
        rows = torch.cat([present, past], -2)  # (n, K + 1, 6)
        index = self._kept("whole").expand(rows.shape[:-2])
        shown = between(rows, index.unsqueeze(-1), self._kept("share")).squeeze(-2)
        return self._write(td, pose, velocity, *shown.split(3, -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, self._rows_back, 6, device=device)}

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        dead_time = self.values["dead_time"]
        most = rows_back(dead_time, dt)
        whole, share = taps(dead_time, dt, most)
        beyond = steady(pose[..., -1, :], velocity[..., -1, :], most, dt)
        rows = torch.cat([torch.cat([pose, velocity], -1), beyond], -2)  # (*, T + K, 6)
        index = torch.arange(pose.shape[-2], device=pose.device) + whole.unsqueeze(-1)
        index = index.expand(pose.shape[:-1])
        then = between(rows, index, share.unsqueeze(-1) if share.dim() else share)
        return then[..., :3], then[..., 3:]


class SensorLag(SensingEffect):
    """A sensor that filters by a first-order lag.

    Exact for motion that is linear over a step: with e = exp(-dt / T) and q = (1 - e) T / dt,
    z' = x' + (q - e) (x - x') + e (z - x'). The memory [12] is z and x; at a reset z trails a car
    that came there at constant velocity.
    """

    name = "sensor_lag"
    equation = "time_constant dz/dt = (pose, velocity) - z"
    declared = (
        EffectParameter(
            "time_constant", 0.0, 0.0, 1.0, "s", "Time in which 63 % is shown.", 0.05, 0.01
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lag = 1000 * values["time_constant"]
        return f"the sensor smooths what it shows, and shows it {lag:.3g} ms late"

    def _values_changed(self) -> None:
        lag = self._here("time_constant").clamp_min(SHORTEST_LAG)
        passed = -torch.expm1(-self.dt / lag)
        left = (1 - passed).unsqueeze(-1)
        self._keep(left=left, last=(passed * lag / self.dt).unsqueeze(-1) - left)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if not self.active:
            return tensordict_reset
        pose, velocity = measured(tensordict_reset)
        lag = self.values["time_constant"].unsqueeze(-1)
        floor = rotate(velocity[..., :2], pose[..., 2])
        trailing = pose - lag * torch.cat([floor, velocity[..., 2:]], -1)
        memory = torch.cat([trailing, velocity, pose, velocity], -1)
        tensordict_reset.set(self.memory, memory)
        return self._write(
            tensordict_reset, pose, velocity, self._take(trailing), self._take(velocity)
        )

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return next_tensordict
        pose, velocity = measured(next_tensordict)
        memory = tensordict.get(self.memory)
        shown, before = self._take(memory).split(6, -1)
        now = torch.cat([self._take(pose), self._take(velocity)], -1)
        left, last = self._kept("left"), self._kept("last")
        shown = now + last * (before - now) + left * (shown - now)
        next_tensordict.set(self.memory, self._put(memory, torch.cat([shown, now], -1)))
        return self._write(next_tensordict, pose, velocity, *shown.split(3, -1))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, 12, device=device)}

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        lag = over_time(self.values)["time_constant"].unsqueeze(-1)
        return pose + lag * rate(pose, dt), velocity + lag * rate(velocity, dt)


def steady(pose: Tensor, velocity: Tensor, rows: int, dt: float) -> Tensor:
    """Pose and velocity [*, rows, 6] of a car that goes on, or went, with what it has [*, 3].

    Args:
        pose: [*, 3]
        velocity: [*, 3]
        rows: How many, the first one a step away.
        dt: Step [s]; negative into the past.
    """
    count = torch.arange(1, rows + 1, device=pose.device)
    turn = dt * velocity[..., 2:]  # (*, 1)
    yaw = pose[..., 2:] + turn * count  # (*, rows)
    steps = rotate(dt * velocity[..., None, :2].expand(*yaw.shape, 2), yaw - 0.5 * turn)
    position = pose[..., None, :2] + steps.cumsum(-2)
    there = torch.cat([position, yaw.unsqueeze(-1)], -1)  # (*, rows, 3)
    return torch.cat([there, velocity.unsqueeze(-2).expand_as(there)], -1)


def between(rows: Tensor, index: Tensor, share: Tensor) -> Tensor:
    """Rows [*, R, 6] at indices [*, T], moved by a share [*, 1] or () towards the next row."""
    index = index.unsqueeze(-1).expand(*index.shape, rows.shape[-1])
    first, second = rows.gather(-2, index), rows.gather(-2, index + 1)
    weight = share.reshape(*share.shape, *(1,) * (first.dim() - share.dim()))
    return first + weight * (second - first)


def rate(record: Tensor, dt: float) -> Tensor:
    """Slope [*, T, n] of a record in time: of the straight line through the rows around each.

    Before its first and after its last row the record is taken to go on as if turned by half a
    revolution about that row.
    """
    reach = min(SMOOTHING, record.shape[-2] - 1)
    if reach < 1:
        return torch.zeros_like(record)
    first, last = record[..., :1, :], record[..., -1:, :]
    before = 2 * first - record[..., 1 : reach + 1, :].flip(-2)
    after = 2 * last - record[..., -reach - 1 : -1, :].flip(-2)
    windows = torch.cat([before, record, after], -2).unfold(-2, 2 * reach + 1, 1)
    place = torch.arange(-reach, reach + 1, device=record.device, dtype=record.dtype)
    return (windows * place).sum(-1) / (place.square().sum() * dt)
