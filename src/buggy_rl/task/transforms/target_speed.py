"""A target speed, drawn at each reset."""

import torch
from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.task.transforms.base import RandomTransform, numbers


class TargetSpeed(RandomTransform):
    """v* ~ U(low, high), the same for an episode; writing `target_speed` in between changes it.

    Args:
        low: [m/s]
        high: [m/s]; equal to `low` for one speed always.
    """

    before: tuple[str, ...] = (keys.OBSERVATION,)

    def __init__(self, low: float = 1.0, high: float = 3.0) -> None:
        super().__init__()
        if not 0 <= low <= high:
            raise ValueError(f"target_speed: low {low} and high {high} m/s are no range above 0")
        self.low, self.high = low, high
        self.writes = {keys.TARGET_SPEED: numbers(1)}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        pose = next_tensordict.get(keys.POSE)
        shape = (*pose.shape[:-1], 1)
        share = torch.rand(shape, generator=self.generator, device=pose.device)
        return next_tensordict.set(keys.TARGET_SPEED, self.low + (self.high - self.low) * share)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict.set(keys.TARGET_SPEED, tensordict.get(keys.TARGET_SPEED))
