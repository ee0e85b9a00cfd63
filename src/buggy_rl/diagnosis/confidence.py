"""Confidence: posterior probability of each effect among its alternatives, calibrated."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import torch

from buggy_rl.diagnosis.candidate import Candidate, excess_misfit, substitutes
from buggy_rl.diagnosis.config import SelectionConfig
from buggy_rl.diagnosis.constancy import Variation
from buggy_rl.diagnosis.posterior import LISTED, Posterior
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.estimation.misfit import CAP


@dataclass(frozen=True)
class Confidence:
    """Of one effect of the best hypothesis."""

    probability: float
    alternatives: dict[str, float]
    """Other effects in its place -> their probability."""
    varies: str = ""
    """Condition with which its parameters change so much that it is rather misspecified."""


@dataclass(frozen=True)
class Doubts:
    """What speaks against effects beside their alternatives."""

    closed: Mapping[str, float]
    """Effect -> share of the first excess that it closes."""
    unclosed: float
    """Share that nothing closes."""
    varies: Mapping[str, Variation]
    """Effect -> what its parameters change with."""
    at_bound: Collection[str] = ()
    """Effects whose parameters lie at an end of their range."""


def confidences(
    found: SearchResult, doubts: Doubts, rules: SelectionConfig
) -> dict[str, Confidence]:
    """Of each effect: its probability among all that could stand in its place.

    p_i ~ exp(-d_i) over hypotheses that differ in this effect alone, d_i from `_worse`; times the
    soundness of what it closes against what remains, times its constancy, and halved at a bound.

    Args:
        found: What the search found.
        doubts: What else speaks against each effect.
        rules: Thresholds.
    """
    result = {}
    for effect in found.best.effects:
        others = frozenset(found.best.effects) - {effect}
        candidates = substitutes(found.tried, others)
        worse = [_worse(found, candidate, rules) for candidate in candidates.values()]
        shares = torch.softmax(-torch.tensor(worse, dtype=torch.float64), 0).tolist()
        share = dict(zip(candidates, shares, strict=True))
        own = share.pop(effect)
        same = constancy(doubts.varies[effect], found.closed(effect), rules)
        within = rules.at_bound_factor if effect in doubts.at_bound else 1.0
        sound = soundness(doubts.closed[effect], doubts.unclosed, rules)
        listed = sorted(share.items(), key=lambda item: -item[1])
        result[effect] = Confidence(
            min(rules.most_confident, own) * sound * same * within,
            {n: p for n, p in listed if p > rules.least_probability and n},
            doubts.varies[effect].condition if same < rules.misspecified else "",
        )
    return result


def posterior_confidences(found: SearchResult, posterior: Posterior) -> dict[str, Confidence]:
    """Of each effect of the best hypothesis, by the posterior of all sets."""
    result = {}
    for effect in found.best.effects:
        others = posterior.in_place_of(effect)
        listed = {other: p for other, p in others.items() if p >= LISTED}
        result[effect] = Confidence(min(1.0, posterior.of(effect)), listed)
    return result


def _worse(found: SearchResult, other: Candidate, rules: SelectionConfig) -> float:
    """By how much an alternative is less likely than the best hypothesis [nats].

    min(sharpness nats, odds of what both leave): nats count segments as if what no equation closes
    were drawn anew in each. The odds are those on all segments, or on those in which the two
    differ, whichever tells more: a manoeuvre driven to decide between them is few among many.
    """
    nats = rules.sharpness * (found.loss(other) - found.loss(found.best))
    three = (found.null, found.best, other)
    everywhere = [excess_misfit(candidate, found.null) for candidate in three]
    odds = [_residual_odds(e, rules) for e in (everywhere, _where_they_differ(*three))]
    return min(nats, max(*odds, 0.0))


def _residual_odds(excess: Sequence[float], rules: SelectionConfig) -> float:
    """What excess misfits, as given, of the best and of an alternative, say against it [nats]."""
    first, own, its = excess
    times = (max(its, 0.0) + rules.exact) / (max(own, 0.0) + rules.exact)
    share = (its - own) / max(first, rules.exact)
    return max(rules.residual_odds * math.log(times), rules.share_odds * share)


def _where_they_differ(null: Candidate, best: Candidate, other: Candidate) -> list[float]:
    """Excess misfits of all three, segments weighed by how far the last two are apart."""
    apart = (other.fit.whitened - best.fit.whitened).square().mean(-1).clamp_max(CAP)
    weight = apart / apart.sum().clamp_min(1e-12)

    def excess(candidate: Candidate) -> float:
        return float((weight * candidate.held_out.clamp_max(CAP).sqrt()).sum()) - 1

    return [excess(null), excess(best), excess(other)]


def soundness(closed: float, remains: float, rules: SelectionConfig) -> float:
    """Probability that a name is right, by the shares of the first excess it closes and leaves.

    r^a / (r^a + even_ratio^a), r = closed / remains, a = steepness.
    """
    own, even = closed**rules.steepness, (rules.even_ratio * remains) ** rules.steepness
    return own / (own + even) if own + even > 0 else 0.0


def constancy(changing: Variation, closed: float, rules: SelectionConfig) -> float:
    """Probability that an effect is right, by how much its parameters would close if they varied.

    1 / (1 + (v / varying_share)^a), v = (closes - constant_gain) / closed, a = steepness.
    """
    more = max(0.0, changing.closes - rules.constant_gain) / max(closed, 1e-9)
    return 1.0 / (1.0 + (more / rules.varying_share) ** rules.steepness)
