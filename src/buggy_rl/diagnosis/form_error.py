"""Form error: how far an effect's numbers are off because its equation is not the car's own.

    sd^2 = (chance sd_blocks)^2 + (always z)^2 + (remains share z)^2

with `sd_blocks` the standard deviation by leaving out blocks, z the number from neutral, and
`share` what is left over what the effect closes: if all that remains were more of the effect, or
less, its number would be off by that. `chance`, `always` and `remains` are fitted to development
cases (`blind_test.intervals`).
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class FormError:
    """A factor of the deviation by leaving out blocks, and two shares of a number."""

    chance: float = 1.0
    """Of the deviation by leaving out blocks, which does not see what all blocks share."""
    always: float = 0.0
    """By which a number is off although nothing remains."""
    remains: float = 1.0
    """Of what remains."""

    def sd(self, z: float, by_blocks: float, share: float) -> float:
        """Standard deviation of a number z [prior scales]."""
        return math.hypot(self.chance * by_blocks, self.always * z, self.remains * share * z)
