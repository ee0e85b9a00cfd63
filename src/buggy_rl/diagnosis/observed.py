"""What is observed of a joint search: the numbers from which probabilities are computed.

The same numbers are a line of a development ledger, so that what is calibrated is what is used.
"""

from dataclasses import asdict
from typing import Any

import torch

from buggy_rl.diagnosis.candidate import Candidate, excess_misfit
from buggy_rl.diagnosis.constancy import variation
from buggy_rl.diagnosis.criteria import Criteria
from buggy_rl.diagnosis.joint import JointSearch, Weighed
from buggy_rl.diagnosis.unexplained import CLIPPED, by_condition, unexplained

DIGITS = 5  # of every number
DEPENDS = 0.05  # [-] share of a variance; what depends on it is not among the numbers


def observed(criteria: Criteria, found: JointSearch) -> dict[str, Any]:
    """The numbers of a search, as JSON has them.

    Args:
        criteria: Blocks, and the baseline.
        found: What was searched.

    Returns:
        `first`, excess misfit of the simulator as given; `usual`, mean and standard error of that
        on the baseline; `segments`, `dispersion`; `hypotheses`, a dictionary for each.
    """
    usual = criteria.usual
    gains = gains_on_baseline(criteria, found)
    return rounded(
        {
            "first": excess_misfit(found.null, found.null),
            "usual": [usual.mean, usual.error],
            "segments": len(found.problem.segments),
            "dispersion": found.problem.dispersion,
            "hypotheses": [
                _hypothesis(criteria, found, weighed) | {"on_baseline": gain}
                for weighed, gain in zip(found.weighed, gains, strict=True)
            ],
        }
    )


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


def _hypothesis(criteria: Criteria, found: JointSearch, weighed: Weighed) -> dict[str, Any]:
    candidate = weighed.candidate
    fit, problem = candidate.fit, found.problem
    rest = unexplained(problem, found.null.fit.whitened, fit.whitened, DEPENDS, criteria.usual)
    loss = problem.noise.loss(candidate.cross_validated.square, problem.dispersion)
    blocks = torch.zeros(int(criteria.group.max()) + 1, dtype=loss.dtype)
    covariance = candidate.cross_validated.covariance
    readings = fit.whitened.view(len(fit.whitened), -1, 6).square().clamp_max(CLIPPED)
    return {
        "effects": list(candidate.key),
        "asked": weighed.asked,
        "values": {effect: v for effect, v in fit.values().items()},
        "z": fit.vector.tolist(),
        "sd": covariance.diagonal().clamp_min(0.0).sqrt().tolist(),
        "correlation": _correlation(covariance),
        "at_bound": [effect for effect in fit.effects if fit.at_bound(effect)],
        "held_out": blocks.index_add_(0, criteria.group, loss).tolist(),
        "penalty": float(fit.penalty()),
        "excess": excess_misfit(candidate, found.null),
        "typical": candidate.typical,
        "unclosed": rest.unclosed,
        "channel": list(rest.channel.values()),
        "by_condition": list(by_condition(problem, readings.sum(-1)).values()),
        "varies": _varies(criteria, found, candidate),
        "evidence": asdict(weighed.evidence),
    }


def _correlation(covariance: torch.Tensor) -> list[float]:
    """Of each pair of numbers, row by row below the diagonal."""
    sd = covariance.diagonal().clamp_min(1e-12).sqrt()
    rows, columns = torch.tril_indices(len(sd), len(sd), -1)
    return (covariance / torch.outer(sd, sd))[rows, columns].tolist()


def _varies(criteria: Criteria, found: JointSearch, candidate: Candidate) -> dict[str, list]:
    """Effect -> condition that its numbers vary with most, excess that this closes, nats."""
    every = {
        effect: variation(criteria, found.problem, candidate, found.null, effect)
        for effect in candidate.effects
    }
    return {effect: [v.condition, v.closes, v.nats] for effect, v in every.items()}


def rounded(value: Any) -> Any:
    """Every number to `DIGITS` digits, however deep."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, dict):
        return {key: rounded(v) for key, v in value.items()}
    if isinstance(value, list):
        return [rounded(v) for v in value]
    return value
