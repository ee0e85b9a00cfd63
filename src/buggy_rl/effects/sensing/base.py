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

    def unsensed(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        if not self.active:
            return pose, velocity
        # Time last but one in memory: a sum over it then does not depend on the number of rows.
        rows, rows_velocity = (self._gather(part, 2).contiguous() for part in (pose, velocity))
        own_pose, own_velocity = self._true_motion(rows, rows_velocity, dt)
        return self._scatter(pose, own_pose, 2), self._scatter(velocity, own_velocity, 2)

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """`unsensed` of the active rows [n, T, 3]; what is measured by default."""
        return pose, velocity

    def _over_time(self, name: str) -> Tensor:
        """Values [n, 1] of a parameter in the active rows, or () for one that all rows share."""
        value = self._value(name)
        return value.unsqueeze(-1) if value.dim() else value

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
