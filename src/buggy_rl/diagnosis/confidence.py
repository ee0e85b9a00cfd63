"""How sure an answer is: rivals weighed against one another, calibrated on cases made for that."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import torch

from buggy_rl.diagnosis.candidate import Candidate, in_its_place, size
from buggy_rl.diagnosis.constancy import Varying
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.estimation.misfit import CAP

SHARPNESS = 0.25  # of nats: neighbours in time are not independent, and no library is complete
ALIKE = 2.0  # nats by which e times as much left over speaks against a rival,
SHARES = 25.0  # and as much as the whole gap; both chosen on a handful of cases
EXACT = 0.01  # excess below which an explanation leaves nothing: the noise's own is as large
CLOSE = 0.02  # a rival less probable than this is not worth a mention
SOUND = 0.28  # share of the first excess above which, beside no sure name, physics is unknown
EVEN = 1.1  # share that a cause closes over what remains, at which it is as likely right as not,
SHARP = 2.0  # and how sharply that changes,
CEILING = 0.99  # and nothing is surer than this: calibrated on the proof's development cases
SAME = 0.02  # of the noise: what varying a number closes counts beyond this; by the share
VARIED = 0.015  # of what its cause closes at which that is as likely a lookalike as not,
AT_END = 0.5  # of a name whose number lies at the end of its range: as likely right as not
LOOKALIKE = 0.5  # and one that is less likely right than this is said to be one


@dataclass(frozen=True)
class Confidence:
    """Of one cause of the best explanation."""

    sure: float
    rivals: dict[str, float]
    varies: str = ""
    """Condition with which its numbers change so much that it is rather a lookalike."""


def confidences(
    search: Search,
    found: Found,
    closed: Mapping[str, float],
    remains: float,
    varies: Mapping[str, Varying],
    at_end: Collection[str] = (),
) -> dict[str, Confidence]:
    """Of each cause: its share among all that could stand in its place.

    p_i ~ exp(-d_i) over explanations that differ in this cause alone, d_i = SHARPNESS nats by
    which it is worse. But nats count stretches as if what no equation closes were drawn anew in
    each. So a rival is no less likely than what it leaves speaks against it: that is several times
    as much as the best leaves, or a part of the first gap that matters. A name beside which much
    is left unexplained is less sure, whatever its rivals; and one whose numbers change with how one
    drives. So is one whose number would be further from neutral yet if its range did not end: no
    fault of that kind is expected to be so large.

    Args:
        search: That found them.
        found: What it found.
        closed: Cause -> share of the first excess that it closes.
        remains: Share that nothing closes.
        varies: Cause -> what its numbers change with.
        at_end: Causes whose numbers lie at the end of their range.
    """
    result = {}
    for cause in found.best.causes:
        others = frozenset(found.best.causes) - {cause}
        rivals = in_its_place(found.tried, others)
        worse = [_worse(search, found, rival) for rival in rivals.values()]
        shares = torch.softmax(-torch.tensor(worse, dtype=torch.float64), 0).tolist()
        share = dict(zip(rivals, shares, strict=True))
        own = share.pop(cause)
        same = constancy(varies[cause], found.closed(cause))
        within = AT_END if cause in at_end else 1.0
        result[cause] = Confidence(
            min(CEILING, own) * soundness(closed[cause], remains) * same * within,
            {n: p for n, p in sorted(share.items(), key=lambda i: -i[1]) if p > CLOSE and n},
            varies[cause].condition if same < LOOKALIKE else "",
        )
    return result


def _worse(search: Search, found: Found, rival: Candidate) -> float:
    """By how much a rival is less likely than the best explanation [nats].

    min(SHARPNESS nats, max(ALIKE ln(rest_rival / rest), SHARES (rest_rival - rest) / gap)), on all
    stretches or on those in which the two differ, whichever tells more: a manoeuvre that was driven
    to decide between them is few among many.
    """
    nats = SHARPNESS * (search.loss(rival) - search.loss(found.best))
    three = (found.null, found.best, rival)
    everywhere = tuple(size(candidate, found.null) for candidate in three)
    return min(nats, max(_left_over(*everywhere), _left_over(*_where_they_differ(*three)), 0.0))


def _left_over(gap: float, own: float, its: float) -> float:
    """What excesses over the noise say against a rival, where the best leaves `own`."""
    times = (max(its, 0.0) + EXACT) / (max(own, 0.0) + EXACT)
    return max(ALIKE * math.log(times), SHARES * (its - own) / max(gap, EXACT))


def _where_they_differ(null: Candidate, best: Candidate, rival: Candidate) -> tuple[float, ...]:
    """Excesses of all three, stretches weighed by how far the last two are apart."""
    apart = (rival.fitted.white - best.fitted.white).square().mean(-1).clamp_max(CAP)
    weight = apart / apart.sum().clamp_min(1e-12)
    roots = ((weight * c.held_out.clamp_max(CAP).sqrt()).sum() for c in (null, best, rival))
    return tuple(float(root) - 1 for root in roots)


def soundness(closed: float, remains: float) -> float:
    """How likely a name is right, by the shares of the first excess that it closes and leaves.

    r^SHARP / (r^SHARP + EVEN^SHARP), r = closed / remains.
    """
    own, even = closed**SHARP, (EVEN * remains) ** SHARP
    return own / (own + even) if own + even > 0 else 0.0


def constancy(changing: Varying, closed: float) -> float:
    """How likely a name is right, by how much more its numbers would close if they varied.

    1 / (1 + (v / VARIED)^SHARP), v what they would close beyond `SAME` over what the cause closes.
    """
    more = max(0.0, changing.closes - SAME) / max(closed, 1e-9)
    return 1.0 / (1.0 + (more / VARIED) ** SHARP)
