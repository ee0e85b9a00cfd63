"""Drivers that see nothing: random commands, and a replay of what was once commanded."""

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD


class ReplayDriver(TensorDictModuleBase):
    """u_t = the command of row t, whatever the car does.

    Args:
        actions: [T, 2] throttle, steering for all cars alike, or [*batch, T, 2] for each its own.
    """

    def __init__(self, actions: Tensor) -> None:
        super().__init__()
        if actions.shape[-1] != 2 or actions.ndim < 2:
            raise ValueError(f"actions are {tuple(actions.shape)}: must be [*, T, 2]")
        self.in_keys, self.out_keys = [keys.VELOCITY], [keys.ACTION]
        self.actions, self.row = actions, 0

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the next row's `action` [*, 2].

        Raises:
            IndexError: There is none left.
        """
        if self.row >= self.actions.shape[-2]:
            raise IndexError(
                f"all {self.actions.shape[-2]} commands have been driven: make a new Replay, or "
                "drive no longer than they last"
            )
        velocity = tensordict[keys.VELOCITY]
        action = self.actions[..., self.row, :].to(velocity)
        tensordict[keys.ACTION] = action.expand(*velocity.shape[:-1], 2).clone()
        self.row += 1
        return tensordict


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
