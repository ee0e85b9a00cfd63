"""Replay: drives again what was once commanded."""

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl import keys


class Replay(TensorDictModuleBase):
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
