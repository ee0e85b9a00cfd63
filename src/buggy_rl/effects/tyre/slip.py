"""Other slip angles than the simulated ones: softer tyres, and front wheels that turn by forces.

The friction stays, so that a car that slides does so at the same lateral acceleration. With the
symbols of the package, step 8 of its algorithm is, for an axle at the slip s of the simulated one,

    s' = q (s + C steer / (c D)) - k' f(s'),   f(s) = sin(c atan(s)),   k' = q C k N / (share c),

q its cornering stiffness over the simulated one, `steer` the angle by which the front wheels are
turned more, and k the angle by which they are turned back for each m/s^2 of the front axle's side
force over its share of the mass. The equation is solved by Newton's method.
"""

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from buggy_rl.effects.tyre.change import FrictionChange, changed_by
from buggy_rl.effects.tyre.law import law, slope

STEPS = 3  # of Newton's method: 4 change a side force by under 0.1 % at the bounds
STEEPEST = 0.2  # [-] least derivative of the equation: a wheel that snaps round has none; chosen


@dataclass(frozen=True)
class SlipChange(FrictionChange):
    """What other slip angles change; `ratio` [4, n] is q front and rear, k and `steer`."""

    kernel: ClassVar[str] = "slip_change"
    rows: ClassVar[int] = 4

    def _grip(self, ratio: Tensor) -> Tensor:
        return torch.ones_like(ratio[:2])

    def _slip_now(self, slip: Tensor, ratio: Tensor, load: Tensor) -> tuple[Tensor, Tensor]:
        q, (compliance, steer) = ratio[:2], ratio[2:].unbind()
        front, c = torch.stack([torch.ones_like(steer), torch.zeros_like(steer)]), self.shape
        turned = front * steer * (self.stiffness / (c * self.friction))
        gives = front * compliance * q * self.stiffness * load / (self.share * c)  # k' (2, n)
        wanted = q * (slip + turned)
        now = wanted / (1 + c * gives).clamp_min(STEEPEST)
        for _ in range(STEPS):
            steep = (1 + c * gives * slope(now, c)).clamp_min(STEEPEST)
            now = now - (now + gives * law(now, c) - wanted) / steep
        least = slope(now, c)
        return now, q * least / (1 + c * gives * least).clamp_min(STEEPEST)


REAR_DRIVEN = changed_by((1, 2), kind=SlipChange)
ALL_DRIVEN = changed_by((0, 2), kind=SlipChange)
REAR_DRIVEN_TWO_WAY = changed_by((1, 2), two_way=True, kind=SlipChange)
