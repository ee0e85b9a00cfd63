"""The manoeuvring driver in a room of a larger car's size."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.policies.controllers.recording import Driver
from buggy_rl.similarity import Similarity


class TwinDriver:
    """Shows a driver of the buggy the similar buggy's motion; commands are the same.

    x' = x / L,  v' = v / S,  r' = r L / S; its own time runs L / S slower. Lengths and speeds are
    those of one gravity, S = sqrt(L): a larger car turns with the buggy's lateral acceleration.

    Args:
        driver: Made for a control period of dt S / L.
        scale: Ratios of the car to the buggy.
    """

    def __init__(self, driver: Driver, scale: Similarity) -> None:
        self._driver = driver
        turn = scale.of("rad/s")
        self._pose = torch.tensor([scale.length, scale.length, 1.0])
        self._velocity = torch.tensor([scale.speed, scale.speed, turn])

    def start_pose(self, batch_size: Sequence[int]) -> Tensor:
        """Where its cars start, [*batch, 3]."""
        return self._driver.start_pose(batch_size) * self._pose

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action`."""
        seen = tensordict.select(keys.POSE, keys.VELOCITY).clone()
        seen[keys.POSE] = seen[keys.POSE] / self._pose
        seen[keys.VELOCITY] = seen[keys.VELOCITY] / self._velocity
        tensordict[keys.ACTION] = self._driver(seen)[keys.ACTION]
        return tensordict
