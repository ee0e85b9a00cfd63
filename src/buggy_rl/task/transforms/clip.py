"""Measured velocities clipped to the training range of the learned model."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import nn

from buggy_rl import keys
from buggy_rl.task.transforms.base import TaskTransform, measured_velocity, numbers

# vx, vy [m/s], yaw_rate [rad/s]: the original study clipped the states of its learned model here.
TRAINED_LOW, TRAINED_HIGH = (-1.0, -3.5, -6.5), (3.5, 3.5, 6.5)


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
        self.writes = {keys.MEASURED_VELOCITY: numbers(3)}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        velocity = measured_velocity(next_tensordict).clamp(self.low, self.high)
        return next_tensordict.set(keys.MEASURED_VELOCITY, velocity)
