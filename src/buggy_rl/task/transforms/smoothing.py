"""First-order lag of the commands."""

import math

import torch
from torch import Tensor

from buggy_rl import keys
from buggy_rl.longitudinal import ONE_WAY_REST
from buggy_rl.task.transforms.commands import CommandFilter


class ActionSmoothing(CommandFilter):
    """u'_t = u'_{t-1} + (1 - exp(-dt / time_constant)) (u_t - u'_{t-1}).

    Args:
        time_constant: [s]
        dt: Control period [s].
        rest: Throttle without drive of the simulator.
    """

    memory = keys.SMOOTHED_ACTION

    def __init__(
        self, time_constant: float = 0.05, *, dt: float, rest: float = ONE_WAY_REST
    ) -> None:
        super().__init__(rest)
        if not time_constant > 0:
            raise ValueError(f"action_smoothing: time_constant is {time_constant}: must be above 0")
        self.share = 1.0 - math.exp(-dt / time_constant)

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return torch.lerp(previous, asked, self.share)
