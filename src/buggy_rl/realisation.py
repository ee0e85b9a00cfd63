"""How an effect is realised inside a simulator: as changes of parameters that it declares.

A simulator says so by an attribute `realises`: effect -> changes, beside `declared`. The effect is
then fitted, named and repaired by those parameters in place of a wrapper around the simulator.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from torch import Tensor

Number = TypeVar("Number", float, Tensor)


@dataclass(frozen=True)
class Scaled:
    """parameter' = parameter number^power."""

    parameter: str
    """Of the simulator."""
    number: str
    """Of the effect, neutral at 1."""
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
    """Of the simulator."""
    number: str
    """Of the effect, neutral at 0."""
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
