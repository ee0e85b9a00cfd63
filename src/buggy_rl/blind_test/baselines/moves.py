"""How a simulator's own parameters moved when they were fitted, and what that says."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from buggy_rl.blind_test.baselines.answers import named, number, unnamed
from buggy_rl.blind_test.equivalents import meant
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import OWN

MOVED = 0.1  # [prior scales] by which a parameter must have moved to be wrong
CERTAIN = 2.0  # [standard deviations] by which it must have moved as well


@dataclass(frozen=True)
class Move:
    """Of one parameter."""

    parameter: EffectParameter
    """As it was before."""
    coordinate: float
    """Where it came to [prior scales]."""
    spread: float
    """Standard deviation of that."""

    @property
    def certain(self) -> bool:
        """Whether it is no chance; never, where the spread is not a number."""
        return abs(self.coordinate) >= CERTAIN * self.spread


def farthest(moves: Sequence[Move], *notes: str) -> dict[str, Any]:
    """The answer: the parameter that moved most in prior scales, of those that are certain.

    Where none is, because they trade against one another, it is the one of all that moved most.
    A parameter that is an effect by another name (`SAME`) is called by that, without its number,
    which is of another kind. The confidence is its share of the way that they went.
    """
    far = [move for move in moves if abs(move.coordinate) >= MOVED]
    if not far:
        return unnamed("no_mismatch", *notes, "no parameter has moved")
    far = [move for move in far if move.certain] or far
    first = max(far, key=lambda move: abs(move.coordinate))
    own = OWN + first.parameter.name
    name = meant(own)
    value = number(first.parameter, first.coordinate, first.spread)
    share = abs(first.coordinate) / sum(abs(move.coordinate) for move in far)
    told = f"{first.parameter.name} is {value['value']:.4g}, not {first.parameter.value:.4g}"
    numbers = {first.parameter.name: value} if name == own else {}
    return named("wrong_parameters", name, share, numbers, [*notes, told])
