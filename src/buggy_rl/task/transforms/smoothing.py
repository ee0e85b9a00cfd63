"""First-order lag of the commands."""

import math

import torch
from torch import Tensor

from buggy_rl import keys
from buggy_rl.task.transforms.commands import CommandFilter


class ActionSmoothing(CommandFilter):
    """u'_t = u'_{t-1} + (1 - exp(-dt / time_constant)) (u_t - u'_{t-1}).

    Args:
        time_constant: [s]
        dt: Control period [s].
    """

    memory = keys.SMOOTHED_ACTION

    def __init__(self, time_constant: float = 0.05, *, dt: float) -> None:
        super().__init__()
        if not time_constant > 0:
            raise ValueError(f"action_smoothing: time_constant is {time_constant}: must be above 0")
        self.share = 1.0 - math.exp(-dt / time_constant)

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return torch.lerp(previous, asked, self.share)
