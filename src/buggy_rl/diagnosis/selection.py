"""Selection: what an effect must do on held-out blocks to be accepted."""

from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.diagnosis.candidate import Candidate, excess_misfit
from buggy_rl.diagnosis.config import DEFAULTS, SelectionConfig
from buggy_rl.estimation.cross_validation import advantage
from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.misfit import NO_BASELINE, BaselineMisfit


@dataclass(frozen=True, eq=False)
class Criteria:
    """By what effects are accepted."""

    group: Tensor
    """[N] blocks of segments that are held out together."""
    usual: BaselineMisfit = NO_BASELINE
    baseline: Problem | None = None
    """On segments on which the simulator counts as right."""
    rules: SelectionConfig = DEFAULTS


def accepted(
    criteria: Criteria, problem: Problem, more: Candidate, less: Candidate, null: Candidate
) -> bool:
    """Whether further effects earn their place on what they were not fitted to.

    Without the block that speaks most for them they gain `min_nats` for each parameter. They close
    more than the baseline's standard error, and (min_share + collinear_share R^2) of the first
    excess. And they do not close the baseline's own residuals.

    Args:
        criteria: The thresholds.
        problem: What both were fitted to.
        more: With the further effects,
        less: and without.
        null: The simulator as given.
    """
    rules = criteria.rules
    dispersion = max(1.0, more.typical)
    nats = advantage(
        problem.noise, dispersion, more.cross_validated, less.cross_validated, criteria.group
    )
    added = len(more.fit.coordinates) - len(less.fit.coordinates)
    share = rules.min_share + rules.collinear_share * overlap(problem, more.fit, set(less.effects))
    closed = excess_misfit(less, null) - excess_misfit(more, null)
    return (
        nats.without_best > rules.min_nats * added
        and closed > max(criteria.usual.error, share * excess_misfit(null, null))
        and not mends_baseline(criteria, problem, more, less)
    )


def mends_baseline(criteria: Criteria, problem: Problem, more: Candidate, less: Candidate) -> bool:
    """Whether further effects gain on the baseline likewise: then they are nothing that changed.

    On the baseline they are looked at alone: the other effects have not happened yet.
    """
    if criteria.baseline is None:
        return False
    baseline = criteria.baseline
    further = tuple(e for e in more.effects if e not in less.effects)
    alone = baseline.library.at(further, more.fit.named() | {("", "clock_offset"): 0.0})
    rows = [(alone, torch.zeros_like(alone.vector)), (alone, alone.vector)]
    before, after = (w.square().sum(-1) for w in baseline.whitened(rows))
    loss = baseline.noise.loss
    there = float((loss(before) - loss(after)).mean())
    loss = problem.noise.loss
    gain = loss(less.cross_validated.square) - loss(more.cross_validated.square)
    return there > criteria.rules.max_baseline_gain * float(gain.mean())


def overlap(problem: Problem, fit: Fit, others: set[str]) -> float:
    """Share of what the further effects of a hypothesis close that `others` of it close likewise.

    R^2 of the whitened residuals J z that they close, to first order, on those of each other
    effect.
    """
    assert fit.jacobian is not None
    root = problem.noise.weight(fit.square, problem.dispersion).sqrt()
    closed = fit.jacobian * fit.vector * root[:, None, None]  # (N, D, P)
    parts: dict[str, Tensor] = {}
    for index, coordinate in enumerate(fit.coordinates):
        if coordinate.effect:
            name = coordinate.effect if coordinate.effect in others else ""
            part = closed[..., index].flatten()
            parts[name] = parts[name] + part if name in parts else part
    added = parts.pop("", None)
    if added is None or not parts:
        return 0.0
    columns = torch.stack(list(parts.values()), -1)
    share = torch.linalg.lstsq(columns, added.unsqueeze(-1), driver="gelsd").solution
    explained = (columns @ share).square().sum() / added.square().sum().clamp_min(1e-12)
    return float(explained.clamp(0.0, 1.0))
