"""Selection: what an effect must do on held-out blocks to be accepted."""

from collections.abc import Collection
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

    Args:
        criteria: The thresholds.
        problem: What both were fitted to.
        more: With the further effects,
        less: and without.
        null: The simulator as given.
    """
    rules = criteria.rules
    dispersion = max(1.0, more.typical)
    gain = advantage(
        problem.noise, dispersion, more.cross_validated, less.cross_validated, criteria.group
    )
    added = len(more.fit.coordinates) - len(less.fit.coordinates)
    size = largest_size(problem, more.fit, less.effects)
    required = required_gain(
        criteria,
        excess_misfit(null, null),
        overlap(problem, more.fit, set(less.effects)),
        size if less.effects else 0.0,
    )
    return (
        size > rules.min_size
        and gain.without_best > rules.min_nats * added
        and gain.lost < rules.max_lost * gain.won
        and excess_misfit(less, null) - excess_misfit(more, null) > required
        and not mends_baseline(criteria, problem, more, less)
    )


def largest_size(problem: Problem, fit: Fit, others: Collection[str]) -> float:
    """Size of the further effects of a hypothesis [prior scales], the largest of them."""
    numbers = zip(fit.coordinates, fit.vector.tolist(), strict=True)
    further = ((c, abs(z)) for c, z in numbers if c.effect and c.effect not in others)
    deciding = problem.library.deciding
    return max((z for c, z in further if c.parameter.name in deciding(c.effect)), default=0.0)


def required_gain(
    criteria: Criteria, first: float, overlapping: float = 0.0, size: float = 0.0
) -> float:
    """Excess misfit that an effect must close.

    max(min_gain, standard error of the baseline, (s + collinear_share R^2) first) with the share
    s = min_share, less for a large further effect: a misspecified equation leaves a residual that
    small numbers of others close a little. Where the simulator is as right as on its baseline,
    half the excess, or a quarter that exceeds what any effect closes of nothing.

    Args:
        criteria: The thresholds.
        first: Excess misfit of the simulator as given.
        overlapping: See `overlap`.
        size: See `largest_size`.
    """
    rules, usual = criteria.rules, criteria.usual
    large = (rules.typical_size / max(size, rules.min_size)) ** 2
    share = rules.min_share * max(rules.least_share, min(1.0, large))
    required = max(
        rules.min_gain, usual.error, (share + rules.collinear_share * overlapping) * first
    )
    if first < usual.most:
        half = rules.as_baseline_share * first
        required = max(required, min(half, max(rules.as_baseline_gain, half / 2)))
    return required


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
