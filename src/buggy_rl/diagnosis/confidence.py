"""How sure an answer is: rivals weighed against one another, calibrated on cases made for that."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch

from buggy_rl.diagnosis.search import Candidate, Found, Search

SHARPNESS = 0.25  # of nats: neighbours in time are not independent, and no library is complete
CLOSE = 0.02  # a rival less probable than this is not worth a mention
SOUND = 0.28  # share of the first excess under which a name is as likely right as not,
SOFT = 0.06  # and how sharply that changes: chosen on drives with known and unknown faults
CEILING = 0.98  # nothing is surer than this


@dataclass(frozen=True)
class Confidence:
    """Of one cause of the best explanation."""

    sure: float
    rivals: dict[str, float]


def confidences(search: Search, found: Found, unexplained: float) -> dict[str, Confidence]:
    """Of each cause: its share among all that could stand in its place.

    p_i ~ exp(-SHARPNESS loss_i) over explanations that differ in this cause alone; a name under
    which much is left unexplained is less sure, whatever its rivals.

    Args:
        search: That found them.
        found: What it found.
        unexplained: Share of the first excess that remains.
    """
    sound = soundness(unexplained)
    result = {}
    for cause in found.best.causes:
        others = frozenset(found.best.causes) - {cause}
        rivals = _in_its_place(found.tried, others)
        losses = torch.tensor([search.loss(c) for c in rivals.values()], dtype=torch.float64)
        shares = torch.softmax(-SHARPNESS * losses, 0).tolist()
        share = dict(zip(rivals, shares, strict=True))
        own = share.pop(cause)
        result[cause] = Confidence(
            min(CEILING, own) * sound,
            {n: p for n, p in sorted(share.items(), key=lambda i: -i[1]) if p > CLOSE and n},
        )
    return result


def soundness(unexplained: float) -> float:
    """How likely a name is right, by the share of the first excess that remains under it."""
    return 1 / (1 + math.exp(min((unexplained - SOUND) / SOFT, 50.0)))


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
