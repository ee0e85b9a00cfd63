"""Rivals of a cause that were never tried beside what else is missing."""

from collections.abc import Mapping
from math import inf

from buggy_rl.diagnosis.candidate import Candidate, in_its_place, size
from buggy_rl.estimation.gauss_newton import Fitted, Fitter

NEAR = 0.15  # of the first gap: a rival that left so much more is not tried again
EACH = 2  # rivals of a cause that are


def exchanges(
    fitter: Fitter,
    best: Candidate,
    tried: Mapping[tuple[str, ...], Candidate],
    null: Candidate,
) -> list[Fitted]:
    """The best explanation with one cause in another's place, where each would begin.

    A cause is chosen before it is known what else is missing: wind or a sloped floor, by what they
    close alone. Beside the rest its rival may close as much, or more.

    Args:
        fitter: Fits them.
        best: Explanation by several causes; of fewer there are none.
        tried: All explanations by their causes, sorted.
        null: That of nothing at all.
    """
    gap = size(null, null)
    starts = []
    for cause in best.causes:
        others = frozenset(best.causes) - {cause}
        beside = frozenset(in_its_place(tried, others))
        worse: dict[str, float] = {}
        came: dict[str, Candidate] = {}
        for causes, candidate in tried.items():
            fewer = frozenset(causes) - {cause}
            if cause not in causes or not fewer < others:
                continue
            for rival, other in in_its_place(tried, fewer).items():
                more = size(other, null) - size(candidate, null)
                if rival not in {"", *others, *beside} and more < worse.get(rival, inf):
                    worse[rival], came[rival] = more, other
        near = sorted((r for r in worse if worse[r] < NEAR * gap), key=lambda r: worse[r])
        for rival in near[:EACH]:
            starts.append(_begun(fitter, best.fitted, came[rival].fitted, (*others, rival)))
    return starts


def _begun(fitter: Fitter, best: Fitted, rival: Fitted, causes: tuple[str, ...]) -> Fitted:
    """Causes at the best's numbers, and what it has none for at those that the rival came to."""
    start = fitter.start(sorted(causes))
    known = {
        (u.cause, u.parameter.name): z
        for fitted in (rival, best)
        for u, z in zip(fitted.unknowns, fitted.place.tolist(), strict=True)
    }
    return fitter.start(start.causes, [known[u.cause, u.parameter.name] for u in start.unknowns])
