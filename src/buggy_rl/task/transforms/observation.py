"""Makes what a policy sees of the true motion: noise, filter and clip, then one row of numbers."""

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.data import Composite

from buggy_rl.core import keys
from buggy_rl.task.transforms.base import (
    COUNT,
    RandomTransform,
    TaskTransform,
    batched,
    measured_pose,
    measured_velocity,
    unbounded_spec,
)

PAIRS = 3  # of normal numbers a step: one each for x, y, yaw, vx, vy, yaw_rate
# vx, vy [m/s], yaw_rate [rad/s]: the original study clipped the states of its learned model here.
TRAINED_LOW, TRAINED_HIGH = (-1.0, -3.5, -6.5), (3.5, 3.5, 6.5)


class ObservationNoise(RandomTransform):
    """z = value + sd e,  e ~ N(0, 1), on pose and velocity as measured; the car is not moved.

    A reset draws the first counter of each environment's noise; from there on the noise is a
    function of the counter in the TensorDict, so that two steps from one TensorDict are equal. The
    defaults are those of the tracking camera that recordings are made with.

    Args:
        position: Standard deviation of x and y [m].
        yaw: [rad]
        velocity: Of vx and vy [m/s].
        yaw_rate: [rad/s]
    """

    before: tuple[str, ...] = (keys.OBSERVATION, keys.WAYPOINTS, keys.VELOCITY_ROWS)
    remembers: tuple[str, ...] = (keys.NOISE_STATE,)

    def __init__(
        self,
        position: float = 0.0007,
        yaw: float = 0.002,
        velocity: float = 0.025,
        yaw_rate: float = 0.03,
    ) -> None:
        super().__init__()
        given = {"position": position, "yaw": yaw, "velocity": velocity, "yaw_rate": yaw_rate}
        for name, value in given.items():
            if value < 0:
                raise ValueError(f"observation_noise: {name} is {value}: must not be negative")
        row = [position, position, yaw, velocity, velocity, yaw_rate]
        deviation = torch.tensor(row, dtype=torch.float32)
        self.deviation = nn.Buffer(deviation, persistent=False)
        self.pairs = nn.Buffer(torch.arange(PAIRS), persistent=False)
        measured = {
            keys.MEASURED_POSE: unbounded_spec(3),
            keys.MEASURED_VELOCITY: unbounded_spec(3),
        }
        self.writes = {keys.NOISE_STATE: COUNT, **measured}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        pose = tensordict_reset.get(keys.POSE)
        shape = (*pose.shape[:-1], 1)
        state = tensordict.get(keys.NOISE_STATE, None)
        if state is None:
            state = torch.randint(2**62, shape, generator=self.generator, device=pose.device)
        return self._write(tensordict_reset, state)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict, tensordict.get(keys.NOISE_STATE) + PAIRS)

    def _write(self, td: TensorDictBase, state: Tensor) -> TensorDictBase:
        noise = normal(state + self.pairs) * self.deviation  # (*, 6)
        td.set(keys.NOISE_STATE, state)
        td.set(keys.MEASURED_POSE, measured_pose(td) + noise[..., :3])
        return td.set(keys.MEASURED_VELOCITY, measured_velocity(td) + noise[..., 3:])


def normal(counter: Tensor) -> Tensor:
    """Standard normal numbers [*, 2 n] of counters [*, n] int64, by Box and Muller.

    The bits are those of SplitMix64's finaliser (Steele, Lea, Flood, Fast splittable pseudorandom
    number generators, 2014), which turns consecutive counters into unrelated numbers.
    """
    bits = counter * -0x61C8864680B583EB  # 2^64 / golden ratio, as a signed number
    bits = (bits ^ _shifted(bits, 30)) * -0x40A7B892E31B1A47
    bits = (bits ^ _shifted(bits, 27)) * -0x6B2FB644ECCEEE15
    bits = bits ^ _shifted(bits, 31)
    size = 2**24  # resolution of a float32 in [0, 1)
    radius = torch.sqrt(-2 * torch.log(((bits & (size - 1)).float() + 0.5) / size))
    angle = (_shifted(bits, 40) & (size - 1)).float() * (2 * math.pi / size)
    return torch.cat([radius * torch.cos(angle), radius * torch.sin(angle)], -1)


def _shifted(bits: Tensor, places: int) -> Tensor:
    """Shift to the right that fills in zeros, which >> of a signed number does not."""
    return (bits >> places) & (2 ** (64 - places) - 1)


class PastMean(TaskTransform):
    """v'_t = (v_{t-width+1} + ... + v_t) / width; at the start the mean of what there is.

    The same as `recordings.filters.past_mean`, one row at a time. The memory has a fourth number
    beside each velocity, 1 where there is one, so that its sum counts them.

    Args:
        width: Rows, the present one included; the original study's 5.
    """

    before: tuple[str, ...] = (keys.OBSERVATION,)
    remembers: tuple[str, ...] = (keys.VELOCITY_ROWS,)

    def __init__(self, width: int = 5) -> None:
        super().__init__()
        if width < 1:
            raise ValueError(f"past_mean: width is {width}: must be at least 1")
        self.width = width
        rows, mean = unbounded_spec(width, 4), unbounded_spec(3)
        self.writes = {keys.VELOCITY_ROWS: rows, keys.MEASURED_VELOCITY: mean}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        velocity = measured_velocity(tensordict_reset)
        rows = tensordict.get(keys.VELOCITY_ROWS, None)
        if rows is None:
            rows = velocity.new_zeros((*velocity.shape[:-1], self.width, 4))
        rows = rows.roll(1, -2)  # its last row is the present one
        return self._write(tensordict_reset, rows, velocity)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        rows = tensordict.get(keys.VELOCITY_ROWS)
        return self._write(next_tensordict, rows, measured_velocity(next_tensordict))

    def _write(self, td: TensorDictBase, rows: Tensor, velocity: Tensor) -> TensorDictBase:
        row = torch.cat([velocity, torch.ones_like(velocity[..., :1])], -1).unsqueeze(-2)
        rows = torch.cat([rows[..., 1:, :], row], -2)  # (*, width, 4)
        total = rows.sum(-2)
        td.set(keys.VELOCITY_ROWS, rows)
        return td.set(keys.MEASURED_VELOCITY, total[..., :3] / total[..., 3:])


class ClipVelocity(TaskTransform):
    """v' = min(max(v, low), high) of the measured velocity; the car's motion is unchanged.

    Args:
        low: Of vx, vy [m/s], yaw_rate [rad/s].
        high: Likewise.
    """

    before: tuple[str, ...] = (keys.OBSERVATION,)

    def __init__(
        self, low: Sequence[float] = TRAINED_LOW, high: Sequence[float] = TRAINED_HIGH
    ) -> None:
        super().__init__()
        self.low = nn.Buffer(torch.tensor(low, dtype=torch.float32), persistent=False)
        self.high = nn.Buffer(torch.tensor(high, dtype=torch.float32), persistent=False)
        if self.low.shape != (3,) or self.high.shape != (3,) or not (self.low < self.high).all():
            raise ValueError(f"clip: low {list(low)} and high {list(high)} must bound 3 numbers")
        self.writes = {keys.MEASURED_VELOCITY: unbounded_spec(3)}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        velocity = measured_velocity(next_tensordict).clamp(self.low, self.high)
        return next_tensordict.set(keys.MEASURED_VELOCITY, velocity)


class Observation(TaskTransform):
    """o = (vx, vy, yaw_rate, x_1, y_1, ..., x_10, y_10): the original study's 23 numbers.

    Args:
        inputs: Keys in this order, each flattened; `velocity` is the measured one.
    """

    def __init__(self, inputs: Sequence[str] = (keys.VELOCITY, keys.WAYPOINTS)) -> None:
        super().__init__()
        self.inputs = tuple(inputs)
        if not self.inputs:
            raise ValueError("observation: inputs is empty: name at least one key")

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        batch = next_tensordict.batch_dims
        rows = [self._value(next_tensordict, key).flatten(batch) for key in self.inputs]
        return next_tensordict.set(keys.OBSERVATION, torch.cat(rows, -1))

    def _value(self, td: TensorDictBase, key: str) -> Tensor:
        return measured_velocity(td) if key == keys.VELOCITY else td.get(key)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        written = set(map(str, observation_spec.keys()))
        missing = [key for key in self.inputs if key not in written]
        if missing:
            raise ValueError(
                f"observation: nothing before it writes {', '.join(missing)}; "
                f"available: {', '.join(sorted(written))}"
            )
        batch = observation_spec.shape
        sizes = [observation_spec[key].shape[len(batch) :].numel() for key in self.inputs]
        observation_spec[keys.OBSERVATION] = batched(unbounded_spec(sum(sizes)), observation_spec)
        return observation_spec


class History(TaskTransform):
    """o'_t = (o_{t-rows+1}, ..., o_t), oldest first; after a reset all are the first one.

    The same numbers as TorchRL's `CatFrames(rows, dim=-1)`, which keeps them in the transform;
    here they ride in the TensorDict, so that a step is a function of it and a resumed run goes on
    as it was.

    Args:
        rows: Observations, the present one included.
    """

    reads: tuple[str, ...] = (keys.OBSERVATION,)
    remembers: tuple[str, ...] = (keys.OBSERVATION_ROWS,)

    def __init__(self, rows: int = 4) -> None:
        super().__init__()
        if rows < 1:
            raise ValueError(f"history: rows is {rows}: must be at least 1")
        self.rows = rows

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        row = tensordict_reset.get(keys.OBSERVATION).unsqueeze(-2)
        rows = tensordict.get(keys.OBSERVATION_ROWS, None)
        rows = row.repeat_interleave(self.rows, -2) if rows is None else rows
        return self._write(tensordict_reset, torch.cat([rows[..., :-1, :], row], -2))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        row = next_tensordict.get(keys.OBSERVATION).unsqueeze(-2)
        rows = tensordict.get(keys.OBSERVATION_ROWS)
        return self._write(next_tensordict, torch.cat([rows[..., 1:, :], row], -2))

    def _write(self, td: TensorDictBase, rows: Tensor) -> TensorDictBase:
        td.set(keys.OBSERVATION_ROWS, rows)
        return td.set(keys.OBSERVATION, rows.flatten(-2))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        self._check_place(observation_spec, [keys.OBSERVATION_ROWS])
        size = observation_spec[keys.OBSERVATION].shape[-1]
        rows, flat = unbounded_spec(self.rows, size), unbounded_spec(self.rows * size)
        observation_spec[keys.OBSERVATION_ROWS] = batched(rows, observation_spec)
        observation_spec[keys.OBSERVATION] = batched(flat, observation_spec)
        return observation_spec

    def transform_state_spec(self, state_spec: Composite) -> Composite:
        before = self.parent
        assert before is not None
        observed = before.full_observation_spec.get(keys.OBSERVATION, None)
        if observed is not None:  # else `transform_observation_spec` says so
            rows = batched(unbounded_spec(self.rows, observed.shape[-1]), state_spec)
            state_spec[keys.OBSERVATION_ROWS] = rows
        return state_spec
