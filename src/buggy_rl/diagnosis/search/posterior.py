"""Posterior probability of each set of effects, of nothing, and of what no effect describes.

    p(h) = exp(w . f(h)) / Z,  p(unknown) = exp(v . g) / Z,  Z = sum_h exp(w . f(h)) + exp(v . g)

f are features of a hypothesis, g of the case, both of a `CaseEvidence`; w and v are fitted to
development cases, of which the truth is known, by `scripts/calibrate.py`: a conditional logit
(McFadden 1974). The empty set is the hypothesis that nothing is missing.
"""

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal, TypeVar, cast

import numpy as np
import torch
import yaml
from numpy.typing import NDArray

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
        | _changed(hypotheses, h, float(case.usual.error > 0))
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


def _changed(
    hypotheses: Sequence[HypothesisEvidence], h: HypothesisEvidence, baseline: float
) -> dict[str, float]:
    """Evidence beside what simulator and car differ in anyway; 0 in earlier ledgers."""
    nats = {g.effects: g.changed or 0.0 for g in hypotheses}
    own, most = nats[h.effects], max(nats.values())
    less = [max(n for e, n in nats.items() if effect not in e) for effect in h.effects]
    needed = _scaled(own - max(less)) if less else 0.0
    behind = -_scaled(most - own)
    return {
        "changed": behind,
        "changed_needed": needed,
        "changed_since": baseline * behind,
        "needed_since": baseline * needed,
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
    [own] = [h for h in case.hypotheses if h.effects == effects]
    most = _steady(case, own)
    return {e: v.condition for e, v in own.varies.items() if v.closes > most}


def of_case(case: CaseEvidence) -> dict[str, float]:
    """Features of the alternative that no effect describes what is seen."""
    best, usual = case.leading, case.usual
    alone = float(usual.error <= 0)  # no baseline says what the simulator's form leaves
    first, left = (math.log(usual.beyond(x) + LEFT) for x in (case.first, best.excess))
    nats = [h.changed or 0.0 for h in case.fitted]
    changed = _scaled(max(nats) - (case.null.changed or 0.0))
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
        "changed": changed,
        "changed_since": (1.0 - alone) * changed,
    }


NORMAL = 1.96  # standard deviations of a 95 % interval


Numbers = TypeVar("Numbers", float, NDArray[np.float64])
"""Number, or an array of them."""


@dataclass(frozen=True)
class FormError:
    """A factor of the deviation by leaving out blocks, and two shares of a number."""

    chance: float = 1.0
    """Factor of the deviation by leaving out blocks, which does not see what all blocks share."""
    always: float = 0.0
    """Share by which a number is off although nothing remains."""
    remains: float = 1.0
    """Share of what remains."""

    def sd(self, z: Numbers, by_blocks: Numbers, share: Numbers) -> Numbers:
        """Standard deviation of a number z [prior scales]."""
        form = (self.always * z) ** 2 + (self.remains * share * z) ** 2
        return cast(Numbers, ((self.chance * by_blocks) ** 2 + form) ** 0.5)


EVEN = 0.5  # [-] probability from which a name is rather right than wrong
LISTED = 0.02  # [-] from which it is listed
SURE = 0.9  # [-] from which a hypothesis is decided
STANDING = 0.95  # [-] share of the sets of effects from which it is said whatever else is missing,
LIKELY = 1 / 3  # [-] if the effect itself is as probable
SHIPPED = Path(__file__).with_name("calibration.yaml")


@dataclass(frozen=True)
class Calibration:
    """Weights of the features; what `scripts/calibrate.py` writes."""

    hypothesis: Mapping[str, float]
    """Feature of a hypothesis -> weight."""
    unknown: Mapping[str, float]
    """Feature of a case -> weight for physics that no effect describes."""
    form_error: FormError = field(default_factory=FormError)
    """Form error of numbers: by how much more they are off than by chance."""
    cases: int = 0
    """Cases that the weights were fitted to; 0 where they are not from any."""
    step_error: FormError = field(default_factory=FormError)
    """The same of quantities of step tests; that of numbers until it was fitted to cases."""

    @property
    def lapse(self) -> float:
        """Probability of what none of the cases showed: rule of succession (Laplace 1774)."""
        return 1.0 / (self.cases + 2) if self.cases else 0.0


@dataclass(frozen=True)
class Posterior:
    """Probabilities that sum to 1."""

    sets: Mapping[Effects, float]
    """Set of effects, sorted -> probability; the empty one is nothing."""
    unknown: float
    """Probability that no effect describes what is missing."""

    @property
    def nothing(self) -> float:
        """Probability that nothing is missing."""
        return self.sets.get((), 0.0)

    @property
    def says(self) -> Literal["nothing", "unknown", "effects"]:
        """What is most probable: nothing, what no effect describes, or some set of effects."""
        named = max(0.0, 1.0 - self.nothing - self.unknown)
        if self.nothing >= max(self.unknown, named):
            return "nothing"
        return "unknown" if self.unknown >= named else "effects"

    @property
    def best(self) -> Effects:
        """The median set: effects that most of the probability of all sets of effects has.

        The most probable set where that one is empty or was not fitted; empty where none was.

        Source: Barbieri & Berger (2004), Optimal predictive model selection.
        """
        named = {effects: p for effects, p in self.sets.items() if effects}
        every = sorted({e for effects in named for e in effects})
        median = tuple(e for e in every if self.whatever_else(e) > EVEN)
        return median if median in named else max(named, key=lambda e: named[e], default=())

    def merged(self, same: Mapping[Effects, Effects]) -> "Posterior":
        """Posterior with sets that are another one in other words counted as that one.

        Args:
            same: Set -> the one that it is the same as.
        """
        sets: dict[Effects, float] = {}
        for effects, p in self.sets.items():
            key = same.get(effects, effects)
            sets[key] = sets.get(key, 0.0) + p
        return Posterior(sets, self.unknown)

    def of(self, effect: str) -> float:
        """Probability that an effect is missing, alone or beside others."""
        return sum(p for effects, p in self.sets.items() if effect in effects)

    def whatever_else(self, effect: str) -> float:
        """Probability that an effect is missing if any are, whatever else may be missing."""
        named = 1.0 - self.nothing - self.unknown
        return self.of(effect) / named if named > 0 else 0.0

    def least_sure(self, effects: Effects) -> float:
        """Probability of the least probable effect of a hypothesis; of none, of nothing."""
        return min([self.of(e) for e in effects] or [self.nothing])

    def decided(self, effects: Effects) -> bool:
        """Whether every effect of a hypothesis has the probability `SURE`; of none, nothing."""
        return self.least_sure(effects) >= SURE

    def in_place_of(self, effect: str) -> dict[str, float]:
        """Other effects outside the best set -> probability of sets with them and without it."""
        others: dict[str, float] = {}
        for effects, p in self.sets.items():
            if effect not in effects:
                for other in {*effects} - {*self.best}:
                    others[other] = others.get(other, 0.0) + p
        return dict(sorted(others.items(), key=lambda item: -item[1]))


def certainly_missing(whatever_else: float, probability: float) -> bool:
    """Whether an effect is said to be missing whatever else is, beside unknown physics.

    Its share of the sets of effects alone does not tell: where no effect describes what is seen,
    what resembles it most has nearly all of that share.
    """
    return whatever_else >= STANDING and probability >= LIKELY


def posterior(case: CaseEvidence, calibration: Calibration | None = None) -> Posterior:
    """Posterior of what was observed of a search, by the shipped calibration unless one is given.

    What the calibration's cases cannot rule out (`Calibration.lapse`) goes to unknown physics.
    """
    calibration = calibration or shipped()
    scores = [_score(f, calibration.hypothesis) for f in of_hypotheses(case)]
    scores.append(_score(of_case(case), calibration.unknown))
    lapse = calibration.lapse
    shares = (1 - lapse) * torch.softmax(torch.tensor(scores, dtype=torch.float64), 0)
    *named, unknown = shares.tolist()
    keys = [h.effects for h in case.fitted]
    return Posterior(dict(zip(keys, named, strict=True)), unknown + lapse)


def _score(features: Mapping[str, float], weights: Mapping[str, float]) -> float:
    return sum(weight * features[name] for name, weight in weights.items())


@cache
def shipped() -> Calibration:
    """Calibration that the package comes with."""
    return load_calibration(SHIPPED)


def load_calibration(file: Path) -> Calibration:
    """Reads what `scripts/calibrate.py` wrote."""
    content = yaml.safe_load(file.read_text())
    form = content["form_error"]
    return Calibration(
        content["hypothesis"],
        content["unknown"],
        FormError(**form),
        content["made_from"]["cases"],
        FormError(**content.get("step_error", form)),
    )
