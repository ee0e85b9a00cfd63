"""What speaks for one explanation over another on drives that neither was fitted to."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fitted, Fitter
from buggy_rl.estimation.hypothesis import bounded
from buggy_rl.estimation.noise_model import Likelihood
from buggy_rl.estimation.segments import Stretches

BLOCK = 8.0  # [s] stretches closer than this are held out together


@dataclass(frozen=True)
class Evidence:
    """How well an explanation foretells what it was not fitted to."""

    square: Tensor
    """[N] |W e|^2 of each stretch when its block was held out."""
    covariance: Tensor
    """[P, P] of the place, by leaving out one block at a time."""


def blocks(cut: Stretches, seconds: float = BLOCK) -> Tensor:
    """Number [N] of the block that each stretch belongs to: neighbours of one drive."""
    place = (cut.row.double() * cut.dt / seconds).long()
    _, number = (cut.drive * 100_000 + place).unique(return_inverse=True)
    return number


def evidences(fitter: Fitter, explanations: Sequence[Fitted], group: Tensor) -> list[Evidence]:
    """Holds out one block at a time.

    Without block g the solution moves, to first order, by d_g = (H - H_g)^-1 s_g, with H and s the
    curvature and the score of the loss; the gaps of that block are those of a rollout there.
    Covariance: (G - 1) / G sum_g d_g d_g^T, and what the prior alone holds counts as unknown.
    """
    moved = [_moved(fitter, fitted, group) for fitted in explanations]
    places = [
        (fitted, bounded(fitted.unknowns, fitted.place + move))
        for fitted, (move, _) in zip(explanations, moved, strict=True)
    ]
    whites = fitter.evaluate(places)
    return [
        Evidence(white.square().sum(-1), covariance)
        for white, (_, covariance) in zip(whites, moved, strict=True)
    ]


def evidence(fitter: Fitter, fitted: Fitted, group: Tensor) -> Evidence:
    """Of one explanation."""
    return evidences(fitter, [fitted], group)[0]


def _moved(fitter: Fitter, fitted: Fitted, group: Tensor) -> tuple[Tensor, Tensor]:
    """By how much [N, P] the place moves without each stretch's block, and its covariance."""
    assert fitted.slopes is not None
    curve, score = fitter.normal(fitted)
    prior = torch.tensor([u.prior for u in fitted.unknowns], dtype=torch.float64)
    hessian = curve.sum(0) + torch.diag(prior**-2)
    inverse = torch.linalg.inv(hessian)
    covariance = inverse @ torch.diag(prior**-2) @ inverse
    moves = torch.zeros(len(group), len(fitted.place), dtype=torch.float64)
    names = group.unique()
    for name in names:
        rows = group == name
        move = torch.linalg.solve(hessian - curve[rows].sum(0), score[rows].sum(0))
        moves[rows] = move
        covariance += (len(names) - 1) / len(names) * torch.outer(move, move)
    return moves, covariance


@dataclass(frozen=True)
class Advantage:
    """Of one explanation over another, on what was held out [nats]."""

    won: float
    """In the blocks in which it is better."""
    lost: float
    """In those in which it is worse; above 0."""
    without_best: float
    """In all but the block that speaks most for it."""


def advantage(
    likelihood: Likelihood, temper: float, better: Evidence, worse: Evidence, group: Tensor
) -> Advantage:
    """Of `better` over `worse`."""
    gain = likelihood.loss(worse.square, temper) - likelihood.loss(better.square, temper)
    sums = torch.zeros(int(group.max()) + 1, dtype=gain.dtype).index_add_(0, group, gain)
    won, lost = sums.clamp_min(0.0), -sums.clamp_max(0.0)
    return Advantage(float(won.sum()), float(lost.sum()), float(sums.sum() - sums.max()))
