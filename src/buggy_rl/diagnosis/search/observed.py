"""What is observed of a joint search, and what it comes to by the calibrated posterior."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import torch

from buggy_rl.diagnosis.residuals import CLIPPED, by_condition, unexplained
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.candidate import Effects, excess_misfit, variation
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence, HypothesisEvidence
from buggy_rl.diagnosis.search.joint import JointSearch, Weighed
from buggy_rl.diagnosis.search.posterior import posterior, varying
from buggy_rl.diagnosis.search.result import SearchResult


def concluded(
    criteria: Criteria, found: JointSearch, same: Mapping[Effects, Effects] | None = None
) -> SearchResult:
    """What a search comes to: the probability of each set, and the most probable answer.

    Args:
        criteria: Blocks, and the baseline.
        found: What was searched.
        same: Sets that are another one in other words -> that one, which gets their probability.
    """
    seen, same = search_evidence(criteria, found), same or {}
    probabilities = posterior(seen).merged(same)
    result = found.result(probabilities, partial(varying, seen))
    return replace(result, same=same, observed=seen)


def search_evidence(criteria: Criteria, found: JointSearch) -> CaseEvidence:
    """What is seen of a search, as many digits of it as a ledger has.

    Args:
        criteria: Blocks, and the baseline.
        found: What was searched.
    """
    gains = gains_on_baseline(criteria, found)
    return CaseEvidence(
        first=excess_misfit(found.null, found.null),
        usual=criteria.usual,
        segments=len(found.problem.segments),
        dispersion=found.problem.dispersion,
        hypotheses=tuple(
            _hypothesis(criteria, found, weighed, gain)
            for weighed, gain in zip(found.weighed, gains, strict=True)
        ),
    ).rounded


def gains_on_baseline(criteria: Criteria, found: JointSearch) -> list[float]:
    """What each hypothesis gains on the baseline's own segments, a segment [nats]; 0 without any.

    There nothing has happened yet: what helps there too is an error of the simulator's form.
    """
    baseline = criteria.baseline
    if baseline is None:
        return [0.0] * len(found.weighed)
    right = {("", "clock_offset"): 0.0}
    alone = [
        baseline.library.at(w.candidate.effects, w.candidate.fit.named() | right)
        for w in found.weighed
    ]
    null = baseline.library.hypothesis(())
    rows = [(null, null.vector), *((h, h.vector) for h in alone)]
    before, *after = (w.square().sum(-1) for w in baseline.whitened(rows))
    loss = baseline.noise.loss
    return [float((loss(before) - loss(square)).mean()) for square in after]


def _hypothesis(
    criteria: Criteria, found: JointSearch, weighed: Weighed, on_baseline: float
) -> HypothesisEvidence:
    candidate = weighed.candidate
    fit, problem = candidate.fit, found.problem
    share, given = criteria.rules.depends_share, found.null.fit.whitened
    rest = unexplained(problem, given, fit.whitened, share, criteria.usual)
    loss = problem.noise.loss(candidate.cross_validated.square, problem.dispersion)
    blocks = torch.zeros(int(criteria.group.max()) + 1, dtype=loss.dtype)
    covariance = candidate.cross_validated.covariance
    readings = fit.whitened.view(len(fit.whitened), -1, 6).square().clamp_max(CLIPPED)
    return HypothesisEvidence(
        effects=candidate.key,
        asked=weighed.asked,
        values=fit.values(),
        z=tuple(fit.vector.tolist()),
        sd=tuple(covariance.diagonal().clamp_min(0.0).sqrt().tolist()),
        correlation=_correlation(covariance),
        at_bound=tuple(effect for effect in fit.effects if fit.at_bound(effect)),
        held_out=tuple(blocks.index_add_(0, criteria.group, loss).tolist()),
        penalty=float(fit.penalty()),
        excess=excess_misfit(candidate, found.null),
        typical=candidate.typical,
        unclosed=rest.unclosed,
        channel=tuple(rest.channel.values()),
        by_condition=tuple(by_condition(problem, readings.sum(-1)).values()),
        varies={
            effect: variation(criteria, problem, candidate, found.null, effect)
            for effect in candidate.effects
        },
        evidence=weighed.evidence,
        on_baseline=on_baseline,
        changed=weighed.changed,
    )


def _correlation(covariance: torch.Tensor) -> tuple[float, ...]:
    """Correlation of each pair of numbers, row by row below the diagonal."""
    sd = covariance.diagonal().clamp_min(1e-12).sqrt()
    rows, columns = torch.tril_indices(len(sd), len(sd), -1)
    return tuple((covariance / torch.outer(sd, sd))[rows, columns].tolist())
