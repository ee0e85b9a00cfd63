"""What effects on the sensing have in common: they write what is measured, and move nothing."""

from abc import abstractmethod

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl import keys
from buggy_rl.effects.base import Effect, numbers_spec


class SensingEffect(Effect):
    """z = h(pose, velocity), of what the sensing so far made of them."""

    kind = "sensing"

    def _write(
        self, td: TensorDictBase, pose: Tensor, velocity: Tensor, seen: Tensor, rate: Tensor
    ) -> TensorDictBase:
        td.set(keys.MEASURED_POSE, self._put(pose, seen))
        return td.set(keys.MEASURED_VELOCITY, self._put(velocity, rate))

    def _reading_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {
            keys.MEASURED_POSE: numbers_spec(shape, 3, device=device),
            keys.MEASURED_VELOCITY: numbers_spec(shape, 3, device=device),
        }


class InstantSensing(SensingEffect):
    """A sensing effect without memory."""

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return next_tensordict
        pose, velocity = measured(next_tensordict)
        seen = self._sensed(self._take(pose), self._take(velocity))
        return self._write(next_tensordict, pose, velocity, *seen)

    @abstractmethod
    def _sensed(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Pose and velocity as measured, of the cars that feel the effect [n, 3]."""


def measured(tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] as the sensing so far left them."""
    pose = tensordict.get(keys.MEASURED_POSE, None)
    velocity = tensordict.get(keys.MEASURED_VELOCITY, None)
    return (
        tensordict.get(keys.POSE) if pose is None else pose,
        tensordict.get(keys.VELOCITY) if velocity is None else velocity,
    )
