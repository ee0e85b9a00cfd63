"""Prior scales of effects for a car of another size."""

from dataclasses import replace

from buggy_rl.effects.base import EffectParameter
from buggy_rl.similarity import EXPONENTS, Similarity


def scaled(parameter: EffectParameter, similarity: Similarity) -> EffectParameter:
    """A parameter of an effect with the prior scale that it has in a similar car.

    The neutral value stays, and bounds are widened where the car's are wider. A unit without a
    scaling law stays as it is.

    Args:
        parameter: As the effect declares it, for the buggy.
        similarity: Ratios of the car to the buggy.
    """
    p, factor = parameter, similarity.of(parameter.unit) if parameter.unit in EXPONENTS else 1.0
    if factor == 1.0:
        return p
    return replace(
        p,
        size=factor * p.size,
        probe=p.probe if p.reciprocal else factor * p.probe,
        lower=min(p.lower, factor * p.lower),
        upper=p.upper if p.reciprocal else max(p.upper, factor * p.upper),
        usual=p.usual and (factor * p.usual[0], factor * p.usual[1]),
    )
