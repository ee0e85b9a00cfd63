"""Whether right effects can be told from physics that no effect describes: a test before a method.

Of every development case in which something shows, one hypothesis: the true one, or, where what is
concealed is no effect, the one with the largest evidence. A logistic regression tells the two kinds
apart by what was logged of it, fitted without the sort, or the pairing, that it is asked about.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from buggy_rl.diagnosis.search.case_evidence import CaseEvidence, HypothesisEvidence
from buggy_rl.proof.calibrate.calibration import group
from buggy_rl.proof.ledger import Entry

PRICE = 3.0  # [nats] of an effect more, where nothing is true and the most evident is taken
REGULARISATION = 0.3  # inverse strength, as scikit-learn has it
RESAMPLED = 1000  # times, for the interval
SMALL = 3e-3  # [-] added to shares before their logarithm
USED = {
    "residual only": ("unclosed", "left", "varies"),
    "evidence only": ("gain", "plain_gain", "spread", "variation", "by_spread", "by_variation"),
    "all": (
        "unclosed", "left", "varies",
        "gain", "plain_gain", "spread", "variation", "by_spread", "by_variation", "dispersion",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """One hypothesis of a case."""

    right: bool
    group: str
    """Sort or pairing, left out together."""
    features: Mapping[str, float]


def samples(entries: Sequence[Entry]) -> list[Sample]:
    """Samples of all cases in which the simulator as given is off by more than is usual."""
    found = []
    for entry in entries:
        case, seen = entry.case, entry.evidence
        if seen is None or not case.truth:
            continue
        by_set = {h.effects: h for h in seen.hypotheses}
        if seen.first <= seen.usual.most:
            continue
        unknown = case.family == "unknown"
        if unknown:
            named = {k: h for k, h in by_set.items() if k}
            chosen = max(named, key=lambda k: named[k].evidence.log_evidence - PRICE * len(k))
            kind = group(case)
        elif case.truth in by_set:
            chosen, kind = case.truth, f"{case.plant}, {case.simulator}"
        else:
            continue
        features = _features(seen, by_set[chosen])
        found.append(Sample(not unknown, kind, features))
    return found


def _features(seen: CaseEvidence, chosen: HypothesisEvidence) -> dict[str, float]:
    own, none = chosen.evidence, seen.null.evidence
    closed = max(seen.first - chosen.excess, SMALL)
    plain = own.plain - none.plain
    gained = max(1.0, plain)
    per_segment = 100.0 / own.numbers
    return {
        "unclosed": _log(chosen.unclosed),
        "left": _log(chosen.excess / seen.first),
        "varies": _log(max(v.closes for v in chosen.varies.values()) / closed),
        "gain": math.log1p(max(0.0, per_segment * (own.log_evidence - none.log_evidence))),
        "plain_gain": math.log1p(max(0.0, per_segment * plain)),
        "spread": own.spread,
        "variation": own.variation,
        "by_spread": _log(own.by_spread / gained),
        "by_variation": _log(own.by_variation / gained),
        "dispersion": math.log(own.dispersion),
    }


def _log(share: float) -> float:
    return math.log(SMALL + max(0.0, share))


def area(scores: NDArray, right: NDArray) -> float:
    """Area under the curve of hits over false alarms: the chance that a right one scores more."""
    better = scores[right][:, None] - scores[~right][None, :]
    return float((better > 0).mean() + 0.5 * (better == 0).mean())


def left_out(found: Sequence[Sample], used: Sequence[str]) -> NDArray:
    """Score of each sample by a regression fitted without its group."""
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    x = np.array([[s.features[name] for name in used] for s in found])
    right, group = np.array([s.right for s in found]), np.array([s.group for s in found])
    scores = np.zeros(len(found))
    for name in sorted(set(group)):
        aside = group == name
        # Balanced: a group is of one kind, and the rest has fewer of it.
        regression = LogisticRegression(C=REGULARISATION, class_weight="balanced", max_iter=5000)
        model = make_pipeline(StandardScaler(), regression)
        model.fit(x[~aside], right[~aside])
        scores[aside] = model.decision_function(x[aside])
    return scores


def discrimination(entries: Sequence[Entry], seed: int = 0) -> str:
    """Areas under the curve, a line for each choice of features, with 95 % bootstrap intervals."""
    found = samples(entries)
    right = np.array([s.right for s in found], dtype=bool)
    unknown = sorted({s.group for s in found if not s.right})
    if right.sum() < 5 or (~right).sum() < 5 or len(unknown) < 2:
        return (
            f"{right.sum()} right and {(~right).sum()} unknown hypotheses are too few to tell "
            "apart: 5 of each are needed, and 2 sorts"
        )
    lines = [
        f"{right.sum()} right hypotheses, {(~right).sum()} for what no effect describes; area "
        "under the curve, each sort and pairing judged by a fit without it:"
    ]
    chance = np.random.default_rng(seed)
    for name, used in USED.items():
        scores = left_out(found, used)
        again = []
        while len(again) < RESAMPLED:
            rows = chance.integers(0, len(found), len(found))
            if 0 < right[rows].sum() < len(rows):
                again.append(area(scores[rows], right[rows]))
        low, high = np.quantile(again, [0.025, 0.975])
        lines.append(f"  {name}: {area(scores, right):.3f} ({low:.3f} to {high:.3f})")
    return "\n".join(lines)
