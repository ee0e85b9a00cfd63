"""Form error: how far an effect's numbers are off because its equation is not the car's own.

    sd^2 = (chance sd_blocks)^2 + (always z)^2 + (remains share z)^2

with `sd_blocks` the standard deviation by leaving out blocks, z the number from neutral, and
`share` what is left over what the effect closes: if all that remains were more of the effect, or
less, its number would be off by that. `chance`, `always` and `remains` are fitted to development
cases (`blind_test.intervals`).
"""

from dataclasses import dataclass
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

Numbers = TypeVar("Numbers", float, NDArray[np.float64])
"""One, or an array of them."""


@dataclass(frozen=True)
class FormError:
    """A factor of the deviation by leaving out blocks, and two shares of a number."""

    chance: float = 1.0
    """Of the deviation by leaving out blocks, which does not see what all blocks share."""
    always: float = 0.0
    """By which a number is off although nothing remains."""
    remains: float = 1.0
    """Of what remains."""

    def sd(self, z: Numbers, by_blocks: Numbers, share: Numbers) -> Numbers:
        """Standard deviation of a number z [prior scales]."""
        form = (self.always * z) ** 2 + (self.remains * share * z) ** 2
        return cast(Numbers, ((self.chance * by_blocks) ** 2 + form) ** 0.5)
