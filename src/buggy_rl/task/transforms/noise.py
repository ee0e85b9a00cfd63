"""Measurement noise on pose and velocity."""

import math

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from buggy_rl import keys
from buggy_rl.task.transforms.base import (
    COUNT,
    RandomTransform,
    measured_pose,
    measured_velocity,
    numbers,
)

PAIRS = 3  # of normal numbers a step: one each for x, y, yaw, vx, vy, yaw_rate


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
        deviation = torch.tensor([position, position, yaw, velocity, velocity, yaw_rate])
        self.deviation = nn.Buffer(deviation, persistent=False)
        self.pairs = nn.Buffer(torch.arange(PAIRS), persistent=False)
        measured = {keys.MEASURED_POSE: numbers(3), keys.MEASURED_VELOCITY: numbers(3)}
        self.writes = {keys.NOISE_STATE: COUNT, **measured}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        pose = tensordict_reset.get(keys.POSE)
        shape = (*pose.shape[:-1], 1)
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
    radius = torch.sqrt(-2 * torch.log(((bits & (size - 1)) + 0.5) / size))
    angle = (_shifted(bits, 40) & (size - 1)) * (2 * math.pi / size)
    return torch.cat([radius * torch.cos(angle), radius * torch.sin(angle)], -1)


def _shifted(bits: Tensor, places: int) -> Tensor:
    """Shift to the right that fills in zeros, which >> of a signed number does not."""
    return (bits >> places) & (2 ** (64 - places) - 1)
