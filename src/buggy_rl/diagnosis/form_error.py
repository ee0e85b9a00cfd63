"""Form error: how far an effect's numbers are off because its equation is not the car's own.

    sd^2 = chance^2 + (always z)^2 + (remains share z)^2

with `chance` the standard deviation by leaving out blocks, z the number from neutral, and `share`
what is left over what the effect closes: if all that remains were more of the effect, or less, its
number would be off by that. `always` and `remains` are fitted to development cases
(`blind_test.intervals`).
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class FormError:
    """Two shares of a number."""

    always: float = 0.0
    """By which it is off although nothing remains."""
    remains: float = 1.0
    """Of what remains."""

    def sd(self, z: float, chance: float, share: float) -> float:
        """Standard deviation of a number z [prior scales]."""
        return math.sqrt(chance**2 + z**2 * (self.always**2 + (self.remains * share) ** 2))
