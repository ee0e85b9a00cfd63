"""Features of hypotheses, and of a case, from which their probabilities are computed.

All are computed from the numbers of `observed`, so that a ledger of development cases has them too.
"""

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from buggy_rl.estimation.hypothesis import OWN

Observed = Mapping[str, Any]

LEFT = 0.01  # [noise] excess misfit that counts as none: added before a logarithm
STEADY = 0.02  # [noise], and [-] of what a set closes: variation of its numbers that counts as none
SPREAD = 2.0  # [nats] standard deviation of a block's loss difference, at least
PRICE = 12.0  # [nats] of an effect more, by which the leading hypothesis is chosen
SCALE = 4.0  # [nats] from which differences count by their logarithm; a loss of none, in a ratio


def fitted(case: Observed) -> list[Observed]:
    """Hypotheses that a search came to by itself."""
    return [h for h in case["hypotheses"] if not h.get("asked", False)]


def loss(hypothesis: Observed) -> float:
    """On what was held out, with the prior's penalty [nats]."""
    return sum(hypothesis["held_out"]) + hypothesis["penalty"]


def leading(hypotheses: Sequence[Observed]) -> Observed:
    """The best by held-out loss and a price for each effect."""
    return min(hypotheses, key=lambda h: loss(h) + PRICE * len(h["effects"]))


def beyond(excess: float, usual: Sequence[float]) -> float:
    """Expected excess misfit over the baseline's: E[max(0, x)], x ~ N(excess - mean, error^2)."""
    mean, error = usual
    over = excess - mean
    if error <= 0:
        return max(0.0, over)
    ratio = over / error
    below = 0.5 * math.erfc(ratio / math.sqrt(2))
    return over * (1 - below) + error * math.exp(-0.5 * ratio**2) / math.sqrt(2 * math.pi)


def of_hypotheses(case: Observed) -> list[dict[str, float]]:
    """Features of each of `fitted`; the larger, the likelier, but for `nothing` and `first`."""
    hypotheses = fitted(case)
    best = leading(hypotheses)
    least = min(map(loss, hypotheses))
    evident = max(h["evidence"]["log_evidence"] for h in hypotheses)
    first = beyond(case["first"], case["usual"])
    return [
        _common(case, h, best)
        | _weakest(hypotheses, h)
        | {
            "ratio": -math.log((loss(h) + SCALE) / (least + SCALE)),
            "evidence": -_scaled(evident - h["evidence"]["log_evidence"]),
            "nothing": float(not h["effects"]),
            "first": 0.0 if h["effects"] else -math.log(first + LEFT),
        }
        for h in hypotheses
    ]


def _common(case: Observed, h: Observed, best: Observed) -> dict[str, float]:
    effects = h["effects"]
    left = beyond(h["excess"], case["usual"])
    gained = loss_of_null(case) - loss(h)
    return {
        "blocks": -_scaled(_by_blocks(h["held_out"], best["held_out"])),
        "left": -math.log(left + LEFT),
        "typical": -math.log(max(0.0, h["typical"] - 1) + LEFT),
        "effects": -float(len(effects)),
        "numbers": float(1 + len(effects) - len(h["z"])),
        "at_bound": -float(len(h["at_bound"])),
        "varies": -_varies(case, h),
        "own": -float(sum(e.startswith(OWN) for e in effects)),
        "on_baseline": -_share(h["on_baseline"] * case["segments"], gained) if effects else 0.0,
    }


def _weakest(hypotheses: Sequence[Observed], h: Observed) -> dict[str, float]:
    """What the least needed effect of a set gains over the best of its subsets without it."""
    subsets = [g for g in hypotheses if set(g["effects"]) < set(h["effects"])]
    less = [  # the empty set is always among them
        min((g for g in subsets if effect not in g["effects"]), key=loss) for effect in h["effects"]
    ]
    blocks = [_by_blocks(g["held_out"], h["held_out"]) for g in less]
    return {
        "weakest": _scaled(min(map(loss, less)) - loss(h)) if less else 0.0,
        "weakest_blocks": _scaled(min(blocks, default=0.0)),
    }


def _scaled(nats: float) -> float:
    """sign(x) ln(1 + |x| / SCALE): in a simulator of another form, nats are thousands."""
    return math.copysign(math.log1p(abs(nats) / SCALE), nats)


def loss_of_null(case: Observed) -> float:
    """Loss of the simulator as given [nats]."""
    return next(loss(h) for h in case["hypotheses"] if not h["effects"])


def _share(part: float, whole: float) -> float:
    """A share in [0, 1] of what is gained, nothing where nothing is."""
    return min(max(part, 0.0) / max(whole, 1.0), 1.0)


def _by_blocks(held_out: Sequence[float], best: Sequence[float]) -> float:
    """How surely a hypothesis is worse than another, counting blocks: sign(t) t^2 / 2 [nats]."""
    worse = [a - b for a, b in zip(held_out, best, strict=True)]
    variance = statistics.variance(worse) if len(worse) > 1 else 0.0
    t = sum(worse) / math.sqrt(len(worse) * (variance + SPREAD**2))
    return 0.5 * math.copysign(t * t, t)


def _varies(case: Observed, h: Observed) -> float:
    """ln(1 + what numbers that vary would close, over what counts as none)."""
    closes = max([0.0, *(v[1] for v in h["varies"].values())])  # held out, it may be below 0
    return math.log1p(closes / _steady(case, h))


def _steady(case: Observed, h: Observed) -> float:
    """Excess that numbers which vary may close without a doubt."""
    own = beyond(case["first"], case["usual"]) - beyond(h["excess"], case["usual"])
    return STEADY + STEADY * max(own, 0.0)


def varying(case: Observed, effects: Sequence[str]) -> dict[str, str]:
    """Effect of a fitted set -> condition with which its numbers vary, where they do."""
    [own] = [h for h in fitted(case) if h["effects"] == list(effects)]
    most = _steady(case, own)
    return {e: condition for e, (condition, closes, _) in own["varies"].items() if closes > most}


def of_case(case: Observed) -> dict[str, float]:
    """Features of the alternative that no effect describes what is seen."""
    best = leading(fitted(case))
    alone = float(case["usual"][1] <= 0)  # no baseline says what the simulator's form leaves
    first, left = (
        math.log(beyond(x, case["usual"]) + LEFT) for x in (case["first"], best["excess"])
    )
    return {
        "one": 1.0,
        "left": left,
        "share": left - first,
        "first": first,
        "left_alone": alone * left,
        "first_alone": alone * first,
        "varies": _varies(case, best),
        "dispersion": math.log(case["dispersion"]),
        "effects": float(len(best["effects"])),
        "gained": _scaled(loss_of_null(case) - loss(best)),
        "channel": max(best["channel"]),
        "baseline": 1.0 - alone,
    }
