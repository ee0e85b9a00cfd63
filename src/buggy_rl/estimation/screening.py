"""Screening: all effects at trial sizes in one batch, to see which are worth a fit."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fit, Problem
from buggy_rl.estimation.hypothesis import TRIAL_SIZES, Hypothesis

SCREENED = 44  # segments, spread evenly, on which effects are screened
STAMPED = 0.05  # [prior scales of 0.01 s] clock offset below which it counts as none
FARTHEST = 1.5  # [-] times the way to a trial, along which the cost is minimised


def screened(problem: Problem, base: Fit, keep: int) -> list[Fit]:
    """The most promising starts: the base and one more effect each, at its best trial size."""
    rows = trials(problem, base)
    thin, [few] = thinned(problem, SCREENED, [base])
    best: dict[str, tuple[float, Fit]] = {}
    for trial in thin.rolled_out(rows):
        cost, name = promise(problem, few, trial), trial.effects[-1]
        if name not in best or cost < best[name][0]:
            best[name] = cost, trial
    ranked = sorted(best.values(), key=lambda item: item[0])
    return [trial for _, trial in ranked[:keep]]


def trials(problem: Problem, base: Fit, at: Sequence[float] = TRIAL_SIZES) -> list[Hypothesis]:
    """The base with one effect more, each that it has not, at every trial size."""
    others = [name for name in problem.library.names if name not in base.effects]
    return [start for name in others for start in _trials(problem, base, name, at)]


def _trials(
    problem: Problem, base: Fit, name: str, at: Sequence[float] = TRIAL_SIZES
) -> list[Hypothesis]:
    start = problem.library.hypothesis((*base.effects, name))
    kept, clock = base.vector[:-1], base.vector[-1:]
    # With the base's clock, and with a right one: without the effect, the clock may have taken
    # over a delay that is the effect's.
    stamps = (clock, 0 * clock) if abs(float(clock)) > STAMPED else (clock,)
    return [
        replace(start, vector=torch.cat([kept, torch.tensor(sizes, dtype=torch.float64), stamp]))
        for sizes in problem.library.trials(name, problem.segments, at)
        for stamp in stamps
    ]


def promise(problem: Problem, base: Fit, trial: Fit) -> float:
    """Loss [nats] at the best point between a base and a trial, along a straight line.

    r(t) = r_base + t P (r_trial - r_base), t in 0..1.5, with P projecting off what the base's own
    parameters absorb; or the trial itself, if that is better.
    """
    noise, dispersion = problem.noise, problem.dispersion
    move = trial.whitened - base.whitened  # (N, D)
    weight = noise.weight(base.square, dispersion).unsqueeze(-1)
    if base.jacobian is not None:
        jacobian = base.jacobian  # (N, D, P)
        normal = torch.einsum("ndp,ndq,ne->pq", jacobian, jacobian, weight)
        normal = normal + 1e-9 * torch.eye(len(normal), dtype=normal.dtype)
        along = torch.einsum("ndp,nd,ne->p", jacobian, move, weight)
        move = move - jacobian @ torch.linalg.solve(normal, along)
    curve = float((weight * move.square()).sum())
    share = -float((weight * move * base.whitened).sum()) / max(curve, 1e-12)
    share = min(max(share, 0.0), FARTHEST)
    square = (base.whitened + share * move).square().sum(-1)
    direct: Tensor = noise.loss(trial.square, dispersion).sum()
    return float(torch.minimum(direct, noise.loss(square, dispersion).sum()))


def thinned(problem: Problem, most: int, fits: Sequence[Fit]) -> tuple[Problem, list[Fit]]:
    """A problem on so many of its segments at most, spread evenly, and fits on the same ones."""
    count = len(problem.segments)
    rows = torch.linspace(0, count - 1, min(count, most)).round().long()
    return problem[rows], [fit[rows] for fit in fits]
