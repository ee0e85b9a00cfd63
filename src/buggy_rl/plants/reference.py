"""The reference car as a plant, with all faults of the engine, textbook and unknown."""

from collections.abc import Mapping

from buggy_rl.engines.reference import ReferenceEngine
from buggy_rl.engines.reference.faults import NEUTRAL, effect_of

ABILITIES = frozenset(effect_of(name) for name in NEUTRAL)


def make_reference(
    cars: int, faults: Mapping[str, Mapping[str, float]], parameters: Mapping[str, float] | None
) -> ReferenceEngine:
    """Reference cars with faults; see `buggy_rl.engines.reference.faults`."""
    return ReferenceEngine(cars, parameters=parameters, faults=faults)
