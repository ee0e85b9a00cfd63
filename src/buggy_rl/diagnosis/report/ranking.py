"""Hypotheses by their loss on held-out blocks."""

from dataclasses import dataclass

from buggy_rl.diagnosis.candidate import substitutes
from buggy_rl.diagnosis.search_result import SearchResult


@dataclass(frozen=True)
class Rank:
    """A hypothesis and how much better than the simulator as given it predicts."""

    effects: tuple[str, ...]
    nats: float
    """Decrease of the held-out loss, prior penalty included; below 0 where it predicts worse."""
    chosen: bool


def ranking(found: SearchResult, most: int) -> list[Rank]:
    """The selected hypothesis, then single effects, best first; at most so many of these."""
    base = found.loss(found.null)
    chosen = found.best.effects
    singles = [
        Rank(effects, base - found.loss(candidate), effects == chosen)
        for effects, candidate in found.tried.items()
        if len(effects) == 1
    ]
    singles = sorted(singles, key=lambda rank: -rank.nats)[:most]
    if not chosen or any(rank.chosen for rank in singles):
        return singles
    return [Rank(chosen, base - found.loss(found.best), True), *singles]


def alternatives(found: SearchResult, effect: str) -> list[tuple[str, float]]:
    """Effects tried instead of one, "" for none, and how much worse [nats]; the closest first."""
    best = found.loss(found.best)
    tried = substitutes(found.tried, frozenset(found.best.effects) - {effect})
    result = [(other, found.loss(c) - best) for other, c in tried.items() if other != effect]
    return sorted(result, key=lambda item: item[1])
