"""How sure an answer is: rivals weighed against one another, calibrated on cases made for that."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from buggy_rl.diagnosis.candidate import Candidate, in_its_place, size
from buggy_rl.diagnosis.search import Found, Search

SHARPNESS = 0.25  # of nats: neighbours in time are not independent, and no library is complete
ALIKE = 2.0  # nats by which e times as much left over speaks against a rival,
SHARES = 25.0  # and as much as the whole gap; both chosen on a handful of cases
EXACT = 0.01  # excess below which an explanation leaves nothing: the noise's own is as large
CLOSE = 0.02  # a rival less probable than this is not worth a mention
SOUND = 0.28  # share of the first excess above which, beside no sure name, physics is unknown
EVEN = 1.1  # share that a cause closes over what remains, at which it is as likely right as not,
SHARP = 2.0  # and how sharply that changes,
CEILING = 0.99  # and nothing is surer than this: calibrated on the proof's development cases


@dataclass(frozen=True)
class Confidence:
    """Of one cause of the best explanation."""

    sure: float
    rivals: dict[str, float]


def confidences(
    search: Search,
    found: Found,
    closed: Mapping[str, float],
    remains: float,
) -> dict[str, Confidence]:
    """Of each cause: its share among all that could stand in its place.

    p_i ~ exp(-d_i) over explanations that differ in this cause alone, d_i = SHARPNESS nats by
    which it is worse. But nats count stretches as if what no equation closes were drawn anew in
    each. So a rival is no less likely than what it leaves speaks against it: that is several times
    as much as the best leaves, or a part of the first gap that matters. A name beside which much
    is left unexplained is less sure, whatever its rivals.

    Args:
        search: That found them.
        found: What it found.
        closed: Cause -> share of the first excess that it closes.
        remains: Share that nothing closes.
    """
    result = {}
    for cause in found.best.causes:
        others = frozenset(found.best.causes) - {cause}
        rivals = in_its_place(found.tried, others)
        worse = [_worse(search, found, rival) for rival in rivals.values()]
        shares = torch.softmax(-torch.tensor(worse, dtype=torch.float64), 0).tolist()
        share = dict(zip(rivals, shares, strict=True))
        own = share.pop(cause)
        result[cause] = Confidence(
            min(CEILING, own) * soundness(closed[cause], remains),
            {n: p for n, p in sorted(share.items(), key=lambda i: -i[1]) if p > CLOSE and n},
        )
    return result


def _worse(search: Search, found: Found, rival: Candidate) -> float:
    """By how much a rival is less likely than the best explanation [nats].

    min(SHARPNESS nats, max(ALIKE ln(rest_rival / rest), SHARES (rest_rival - rest) / gap)).
    """
    nats = SHARPNESS * (search.loss(rival) - search.loss(found.best))
    gap, own, its = (size(c, found.null) for c in (found.null, found.best, rival))
    times = (max(its, 0.0) + EXACT) / (max(own, 0.0) + EXACT)
    return min(nats, max(ALIKE * math.log(times), SHARES * (its - own) / max(gap, EXACT), 0.0))


def soundness(closed: float, remains: float) -> float:
    """How likely a name is right, by the shares of the first excess that it closes and leaves.

    r^SHARP / (r^SHARP + EVEN^SHARP), r = closed / remains.
    """
    own, even = closed**SHARP, (EVEN * remains) ** SHARP
    return own / (own + even) if own + even > 0 else 0.0
