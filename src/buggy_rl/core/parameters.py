"""Parameters that a simulator declares, and how an effect is realised as changes of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from torch import Tensor

ROUNDING = 1e-9  # [-] relative slack of a bound: decimal values in files, 0.1218 for 1.4 x 0.087


@dataclass(frozen=True)
class Parameter:
    """One parameter of a simulator and its range."""

    name: str
    value: float
    lower: float
    upper: float
    unit: str
    """SI unit, `-` for a ratio."""
    meaning: str
    """One sentence."""

    def __post_init__(self) -> None:
        slack = ROUNDING * max(abs(self.lower), abs(self.upper))
        if not self.lower - slack <= self.value <= self.upper + slack:
            raise ValueError(
                f"parameter {self.name!r} is {self.value} {self.unit}, outside its range "
                f"[{self.lower:.6g}, {self.upper:.6g}]: correct the value, name the car (car=...) "
                f"or widen the range (ranges: {{{self.name}: [lower, upper]}})"
            )
        # Clamped to the bound: a fit that starts here needs a start within the range.
        object.__setattr__(self, "value", min(max(self.value, self.lower), self.upper))


Number = TypeVar("Number", float, Tensor)


@dataclass(frozen=True)
class Scaled:
    """parameter' = parameter number^power."""

    parameter: str
    """Name of the simulator's parameter."""
    number: str
    """Name of the effect's parameter, neutral at 1."""
    power: float = 1.0

    def changed(self, value: Number, number: Number) -> Number:
        """The parameter at a number of the effect."""
        return value * number**self.power  # type: ignore[return-value]  # of a float, a float

    def number_at(self, value: float, changed: float) -> float:
        """The number at which the parameter has another value."""
        ratio = changed / value
        if ratio <= 0:
            return math.inf if self.power < 0 else 0.0
        return ratio ** (1 / self.power)

    def possible(self, value: float) -> bool:
        """Whether the parameter can be changed so."""
        return value > 0


@dataclass(frozen=True)
class Added:
    """parameter' = parameter + factor number."""

    parameter: str
    """Name of the simulator's parameter."""
    number: str
    """Name of the effect's parameter, neutral at 0."""
    factor: float = 1.0
    """Unit of the parameter over that of the number."""

    def changed(self, value: Number, number: Number) -> Number:
        """The parameter at a number of the effect."""
        return value + self.factor * number

    def number_at(self, value: float, changed: float) -> float:
        """The number at which the parameter has another value."""
        return (changed - value) / self.factor

    def possible(self, value: float) -> bool:
        """Whether the parameter can be changed so."""
        return math.isfinite(value)


Change = Scaled | Added
Realisations = Mapping[str, Sequence[Change]]
"""Effect -> how declared parameters follow from its numbers."""
