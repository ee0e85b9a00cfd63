"""What effects on the sensing have in common: they write what is measured and move nothing."""

from abc import abstractmethod

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.effects.base import Effect, numbers_spec


class SensingEffect(Effect):
    """z = h(pose, velocity), of the measurement of the sensing effects nearer to the engine."""

    kind = "sensing"

    def _set_measured(
        self, td: TensorDictBase, true: tuple[Tensor, Tensor], rows: tuple[Tensor, ...]
    ) -> None:
        """Writes pose and velocity: `true` [*, 3], the active rows replaced by `rows` [n, 3]."""
        td.set(keys.MEASURED_POSE, self._scatter(true[0], rows[0]))
        td.set(keys.MEASURED_VELOCITY, self._scatter(true[1], rows[1]))

    def _reading_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {
            keys.MEASURED_POSE: numbers_spec(shape, 3, device=device),
            keys.MEASURED_VELOCITY: numbers_spec(shape, 3, device=device),
        }


class MemorylessSensing(SensingEffect):
    """A sensing effect without latent state."""

    may_delay = False

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        self._write_step(given, state)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        pose, velocity = sensed_motion(after)
        rows = self._measurement(self._gather(pose), self._gather(velocity))
        self._set_measured(after, (pose, velocity), rows)

    @abstractmethod
    def _measurement(self, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        """Pose and velocity [n, 3] as measured, of the active rows."""


def sensed_motion(tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] as the sensing effects so far left them."""
    pose = tensordict.get(keys.MEASURED_POSE, None)
    velocity = tensordict.get(keys.MEASURED_VELOCITY, None)
    return (
        tensordict.get(keys.POSE) if pose is None else pose,
        tensordict.get(keys.VELOCITY) if velocity is None else velocity,
    )
