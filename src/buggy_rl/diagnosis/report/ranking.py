"""Explanations by what speaks for them."""

from dataclasses import dataclass

from buggy_rl.diagnosis.search import Found, Search


@dataclass(frozen=True)
class Rank:
    """An explanation and how much better than the simulator as given it foretells."""

    causes: tuple[str, ...]
    nats: float
    """Of evidence on what was held out, priors counted; below 0 where it foretells worse."""
    chosen: bool


def ranking(search: Search, found: Found, most: int) -> list[Rank]:
    """What was chosen, then the single causes, best first; at most so many of these."""
    base = search.loss(found.null)
    chosen = found.best.causes
    singles = [
        Rank(causes, base - search.loss(candidate), causes == chosen)
        for causes, candidate in found.tried.items()
        if len(causes) == 1
    ]
    singles.sort(key=lambda rank: -rank.nats)
    singles = singles[:most]
    if not chosen or any(rank.chosen for rank in singles):
        return singles
    return [Rank(chosen, base - search.loss(found.best), True), *singles]


def losers(search: Search, found: Found, cause: str) -> list[tuple[str, float]]:
    """What was tried in a cause's place, and by how many nats it was worse; the closest first.

    The empty name is that of nothing in its place.
    """
    others = frozenset(found.best.causes) - {cause}
    best = search.loss(found.best)
    result = []
    for causes, candidate in found.tried.items():
        rest = frozenset(causes) - others
        same = others <= frozenset(causes) and cause not in causes
        if same and len(rest) <= 1:
            result.append((next(iter(rest), ""), search.loss(candidate) - best))
    return sorted(result, key=lambda item: item[1])
