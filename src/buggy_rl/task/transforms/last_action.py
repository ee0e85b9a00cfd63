"""What the car was told in the step before, for the policy to see and for rewards."""

from torch import Tensor

from buggy_rl.keys import LAST_ACTION
from buggy_rl.task.transforms.commands import CommandFilter


class LastAction(CommandFilter):
    """u'_t = u_t within [-1, 1]. Before a smoothing in the stack it sees what that gives out."""

    memory = LAST_ACTION

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return asked
