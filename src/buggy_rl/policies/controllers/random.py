"""The random driver: the least that anything must beat."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.vehicle import CONTROL_PERIOD


class RandomDriver(TensorDictModuleBase):
    """Commands drawn evenly from [-1, 1], each held for a while.

    Args:
        hold: How long a command is held [s].
        seed: Of the commands; the global random state is neither read nor changed.
    """

    def __init__(self, hold: float = 0.2, seed: int = 0) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [keys.VELOCITY], [keys.ACTION]
        self.steps = max(1, round(hold / CONTROL_PERIOD))
        self._generator = torch.Generator().manual_seed(seed)
        self._held: Tensor | None = None
        self._age = 0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2]."""
        velocity = tensordict[keys.VELOCITY]
        shape = (*velocity.shape[:-1], 2)
        if self._held is None or self._held.shape != shape or self._age % self.steps == 0:
            self._held, self._age = 2 * torch.rand(shape, generator=self._generator) - 1, 0
        self._age += 1
        tensordict[keys.ACTION] = self._held.to(velocity)
        return tensordict
