"""Confidence: posterior probability of each effect that is named."""

from dataclasses import dataclass

from buggy_rl.diagnosis.posterior import LISTED, Posterior
from buggy_rl.diagnosis.search_result import SearchResult


@dataclass(frozen=True)
class Confidence:
    """Of one effect of the best hypothesis."""

    probability: float
    alternatives: dict[str, float]
    """Other effects in its place -> their probability."""
    whatever_else: float
    """Probability if effects are missing at all."""


def confidences(found: SearchResult, posterior: Posterior) -> dict[str, Confidence]:
    """Of each effect of the best hypothesis, by the posterior of all sets."""
    result = {}
    for effect in found.best.effects:
        others = posterior.in_place_of(effect)
        listed = {other: p for other, p in others.items() if p >= LISTED}
        result[effect] = Confidence(
            min(1.0, posterior.of(effect)), listed, min(1.0, posterior.whatever_else(effect))
        )
    return result
