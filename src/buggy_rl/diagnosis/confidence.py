"""How sure an answer is: rivals weighed against one another, calibrated on cases made for that."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch

from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.search import Found, Search

SHARPNESS = 0.25  # of nats: neighbours in time are not independent, and no library is complete
CLOSE = 0.02  # a rival less probable than this is not worth a mention
SOUND = 0.28  # share of the first excess above which what is missing has no name
EVEN = 1.3  # share that a cause closes over what remains, at which it is as likely right as not,
SHARP = 2.0  # and how sharply that changes: both chosen by hand, not calibrated yet
CEILING = 0.98  # nothing is surer than this


@dataclass(frozen=True)
class Confidence:
    """Of one cause of the best explanation."""

    sure: float
    rivals: dict[str, float]


def confidences(
    search: Search, found: Found, closed: Mapping[str, float], remains: float
) -> dict[str, Confidence]:
    """Of each cause: its share among all that could stand in its place.

    p_i ~ exp(-SHARPNESS loss_i) over explanations that differ in this cause alone; a name beside
    which much is left unexplained is less sure, whatever its rivals.

    Args:
        search: That found them.
        found: What it found.
        closed: Cause -> share of the first excess that it closes.
        remains: Share that nothing closes.
    """
    result = {}
    for cause in found.best.causes:
        others = frozenset(found.best.causes) - {cause}
        rivals = _in_its_place(found.tried, others)
        losses = torch.tensor([search.loss(c) for c in rivals.values()], dtype=torch.float64)
        shares = torch.softmax(-SHARPNESS * losses, 0).tolist()
        share = dict(zip(rivals, shares, strict=True))
        own = share.pop(cause)
        result[cause] = Confidence(
            min(CEILING, own) * soundness(closed[cause], remains),
            {n: p for n, p in sorted(share.items(), key=lambda i: -i[1]) if p > CLOSE and n},
        )
    return result


def soundness(closed: float, remains: float) -> float:
    """How likely a name is right, by the shares of the first excess that it closes and leaves.

    r^SHARP / (r^SHARP + EVEN^SHARP), r = closed / remains.
    """
    own, even = closed**SHARP, (EVEN * remains) ** SHARP
    return own / (own + even) if own + even > 0 else 0.0


def _in_its_place(
    tried: Mapping[tuple[str, ...], Candidate], others: frozenset[str]
) -> dict[str, Candidate]:
    """Explanations by these causes and one more, by the one; none more under the empty name."""
    result = {}
    for causes, candidate in tried.items():
        more = frozenset(causes) - others
        if (
            others <= frozenset(causes)
            and len(more) <= 1
            and len(causes) == len(others) + len(more)
        ):
            result[next(iter(more), "")] = candidate
    return result
