"""The command of the last step, for the observation and for rewards."""

from torch import Tensor

from buggy_rl import keys
from buggy_rl.task.transforms.commands import CommandFilter


class LastAction(CommandFilter):
    """u'_t = u_t within [-1, 1]. Nearer to the engine than a filter it records its output."""

    memory = keys.LAST_ACTION

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return asked
