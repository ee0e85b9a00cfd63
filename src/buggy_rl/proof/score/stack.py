"""How near a repaired simulator comes on drives that nothing was fitted to, and what is simpler."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SIMPLER = ("as_given", "retuned", "residual")
"""Simulators as given, with their own parameters fitted alone, with a learned residual alone."""
SLIGHT = 0.001  # [m] by which one distance must be larger to be called so
WORTH = 0.02  # [-] likewise, of the smaller one
SURELY = 2.0  # [standard errors] likewise
SEEN = 1.5  # [-] of what a simulator without fault has, beyond which there is a mismatch to close


def clearly_longer(distance: float, other: float) -> bool:
    """Whether a distance [m] is longer than another by more than is slight."""
    return distance > max(other + SLIGHT, (1 + WORTH) * other)


@dataclass(frozen=True)
class StackErrors:
    """Median distances after 1 s [m] of one case."""

    distance: Mapping[str, float]
    """Distance of the `stack` that is delivered, and of each of `SIMPLER`."""
    farther: Mapping[str, tuple[float, float]]
    """Simpler one -> mean over segments of log(stack / simpler), and its standard error."""
    floor: float
    """Distance of a simulator without fault."""

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "StackErrors":
        """The inverse of `dataclasses.asdict`, from JSON."""
        farther = {name: (more, error) for name, (more, error) in content["farther"].items()}
        return cls(content["distance"], farther, content["floor"])

    @property
    def seen(self) -> bool:
        """Whether there is a mismatch to close."""
        return self.distance["as_given"] > SEEN * self.floor

    def closed(self, name: str = "stack") -> float:
        """Share [-] of the distance between as given and a simulator without fault that is closed.

        Args:
            name: By the stack, or by one of `SIMPLER`.
        """
        given = self.distance["as_given"]
        return (given - self.distance[name]) / (given - self.floor)

    @property
    def beaten(self) -> bool:
        """Whether something simpler is nearer than the stack, by the median and surely."""
        stack = self.distance["stack"]
        for name in SIMPLER:
            more, error = self.farther[name]
            if clearly_longer(stack, self.distance[name]) and more > SURELY * error:
                return True
        return False
