"""Commands that change no faster than a limit."""

import torch
from torch import Tensor, nn

from buggy_rl import keys
from buggy_rl.longitudinal import ONE_WAY_REST
from buggy_rl.task.transforms.commands import CommandFilter


class RateLimit(CommandFilter):
    """u'_t = u'_{t-1} + min(max(u_t - u'_{t-1}, -rate dt), rate dt).

    Args:
        throttle: Fastest change [1/s]; of the whole range, which is 2 wide.
        steering: Likewise.
        dt: Control period [s].
        rest: Throttle without drive of the simulator.
    """

    memory = keys.LIMITED_ACTION

    def __init__(
        self,
        throttle: float = 20.0,
        steering: float = 10.0,
        *,
        dt: float,
        rest: float = ONE_WAY_REST,
    ) -> None:
        super().__init__(rest)
        for name, value in (("throttle", throttle), ("steering", steering)):
            if not value > 0:
                raise ValueError(f"rate_limit: {name} is {value} a second: must be above 0")
        self.largest = nn.Buffer(torch.tensor([throttle * dt, steering * dt]), persistent=False)

    def _filtered(self, previous: Tensor, asked: Tensor) -> Tensor:
        return previous + (asked - previous).clamp(-self.largest, self.largest)
