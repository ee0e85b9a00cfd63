"""Features of hypotheses, and of a case, from which their probabilities are computed.

All are computed from a `CaseEvidence`, which a ledger of development cases has too.
"""

import math
import statistics
from collections.abc import Sequence

from buggy_rl.diagnosis.search.candidate import Effects
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence, HypothesisEvidence
from buggy_rl.estimation.hypothesis import OWN

LEFT = 0.01  # [noise] excess misfit that counts as none: added before a logarithm
STEADY = 0.02  # [noise], and [-] of what a set closes: variation of its numbers that counts as none
SPREAD = 2.0  # [nats] standard deviation of a block's loss difference, at least
SCALE = 4.0  # [nats] from which differences count by their logarithm; a loss of none, in a ratio


def of_hypotheses(case: CaseEvidence) -> list[dict[str, float]]:
    """Features of each of `fitted`; the larger, the likelier, but for `nothing` and `first`."""
    hypotheses, best = case.fitted, case.leading
    least = min(h.loss for h in hypotheses)
    evident = max(h.evidence.log_evidence for h in hypotheses)
    first = case.usual.beyond(case.first)
    return [
        _common(case, h, best)
        | _weakest(hypotheses, h)
        | {
            "ratio": -math.log((h.loss + SCALE) / (least + SCALE)),
            "evidence": -_scaled(evident - h.evidence.log_evidence),
            "nothing": float(not h.effects),
            "first": 0.0 if h.effects else -math.log(first + LEFT),
        }
        for h in hypotheses
    ]


def _common(
    case: CaseEvidence, h: HypothesisEvidence, best: HypothesisEvidence
) -> dict[str, float]:
    effects = h.effects
    left = case.usual.beyond(h.excess)
    gained = case.null.loss - h.loss
    return {
        "blocks": -_scaled(_by_blocks(h.held_out, best.held_out)),
        "left": -math.log(left + LEFT),
        "typical": -math.log(max(0.0, h.typical - 1) + LEFT),
        "effects": -float(len(effects)),
        "numbers": float(1 + len(effects) - len(h.z)),
        "at_bound": -float(len(h.at_bound)),
        "varies": -_varies(case, h),
        "own": -float(sum(e.startswith(OWN) for e in effects)),
        "on_baseline": -_share(h.on_baseline * case.segments, gained) if effects else 0.0,
    }


def _weakest(hypotheses: Sequence[HypothesisEvidence], h: HypothesisEvidence) -> dict[str, float]:
    """What the least needed effect of a set gains over the best of its subsets without it."""
    subsets = [g for g in hypotheses if set(g.effects) < set(h.effects)]
    less = [  # the empty set is always among them
        min((g for g in subsets if effect not in g.effects), key=lambda g: g.loss)
        for effect in h.effects
    ]
    blocks = [_by_blocks(g.held_out, h.held_out) for g in less]
    return {
        "weakest": _scaled(min(g.loss for g in less) - h.loss) if less else 0.0,
        "weakest_blocks": _scaled(min(blocks, default=0.0)),
    }


def _scaled(nats: float) -> float:
    """sign(x) ln(1 + |x| / SCALE): in a simulator of another form, nats are thousands."""
    return math.copysign(math.log1p(abs(nats) / SCALE), nats)


def _share(part: float, whole: float) -> float:
    """A share in [0, 1] of what is gained, nothing where nothing is."""
    return min(max(part, 0.0) / max(whole, 1.0), 1.0)


def _by_blocks(held_out: Sequence[float], best: Sequence[float]) -> float:
    """How surely a hypothesis is worse than another, counting blocks: sign(t) t^2 / 2 [nats]."""
    worse = [a - b for a, b in zip(held_out, best, strict=True)]
    variance = statistics.variance(worse) if len(worse) > 1 else 0.0
    t = sum(worse) / math.sqrt(len(worse) * (variance + SPREAD**2))
    return 0.5 * math.copysign(t * t, t)


def _varies(case: CaseEvidence, h: HypothesisEvidence) -> float:
    """ln(1 + what numbers that vary would close, over what counts as none)."""
    closes = max([0.0, *(v.closes for v in h.varies.values())])  # held out, it may be below 0
    return math.log1p(closes / _steady(case, h))


def _steady(case: CaseEvidence, h: HypothesisEvidence) -> float:
    """Excess that numbers which vary may close without a doubt."""
    own = case.usual.beyond(case.first) - case.usual.beyond(h.excess)
    return STEADY + STEADY * max(own, 0.0)


def varying(case: CaseEvidence, effects: Effects) -> dict[str, str]:
    """Effect of a fitted set -> condition with which its numbers vary, where they do."""
    [own] = [h for h in case.fitted if h.effects == effects]
    most = _steady(case, own)
    return {e: v.condition for e, v in own.varies.items() if v.closes > most}


def of_case(case: CaseEvidence) -> dict[str, float]:
    """Features of the alternative that no effect describes what is seen."""
    best, usual = case.leading, case.usual
    alone = float(usual.error <= 0)  # no baseline says what the simulator's form leaves
    first, left = (math.log(usual.beyond(x) + LEFT) for x in (case.first, best.excess))
    return {
        "one": 1.0,
        "left": left,
        "share": left - first,
        "first": first,
        "left_alone": alone * left,
        "first_alone": alone * first,
        "varies": _varies(case, best),
        "dispersion": math.log(case.dispersion),
        "effects": float(len(best.effects)),
        "gained": _scaled(case.null.loss - best.loss),
        "channel": max(best.channel),
        "baseline": 1.0 - alone,
    }
