"""Blocked cross-validation: how well a fit predicts blocks of a recording that were held out."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fit, Problem, normal_equations
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.estimation.segments import Segments

BLOCK = 8.0  # [s] segments of a recording closer than this are held out together


@dataclass(frozen=True, eq=False)
class CrossValidated:
    """How well a hypothesis predicts what it was not fitted to."""

    whitened: Tensor
    """[N, D] whitened residuals of each segment when its block was held out."""
    covariance: Tensor
    """[P, P] of the vector, by leaving out one block at a time."""

    @property
    def square(self) -> Tensor:
        """|W e|^2 [N] of each segment."""
        return self.whitened.square().sum(-1)


def blocks(segments: Segments, seconds: float = BLOCK) -> Tensor:
    """Number [N] of the block of each segment: neighbours of one recording."""
    position = (segments.row.double() * segments.dt / seconds).long()
    _, number = (segments.recording * 100_000 + position).unique(return_inverse=True)
    return number


def cross_validated(
    problem: Problem, fits: Sequence[Fit], group: Tensor, anew: bool = True
) -> list[CrossValidated]:
    """Holds out one block at a time.

    Args:
        problem: What was fitted to.
        fits: With their derivatives.
        group: [N] int, blocks.
        anew: Whether residuals of what is held out are those of a rollout anew; to first order
            otherwise, which takes no rollout.
    """
    parts = [_without_each(problem, fit, group) for fit in fits]
    rows = [
        (fit, fit.bounded(fit.vector + moves)) for fit, (moves, _) in zip(fits, parts, strict=True)
    ]
    found = problem.whitened(rows) if anew else [_to_first_order(*row) for row in rows]
    return [
        CrossValidated(whitened, covariance)
        for whitened, (_, covariance) in zip(found, parts, strict=True)
    ]


def _to_first_order(fit: Fit, vectors: Tensor) -> Tensor:
    """Whitened residuals [N, D] of a fit at vectors [N, P], along its derivatives."""
    assert fit.jacobian is not None
    return fit.whitened + torch.einsum("ndp,np->nd", fit.jacobian, vectors - fit.vector)


def rewhitened(
    problem: Problem, fit: Fit, known: CrossValidated, change: Tensor, group: Tensor
) -> CrossValidated:
    """Under another noise model, without a rollout: held out at the same numbers.

    Args:
        problem: With the new noise model.
        fit: Under it.
        known: Under the former one.
        change: [N, D, D] of `NoiseModel.change_from`.
        group: [N] int, blocks.
    """
    whitened = torch.einsum("nij,nj->ni", change, known.whitened)
    return CrossValidated(whitened, _without_each(problem, fit, group)[1])


def _without_each(problem: Problem, fit: Fit, group: Tensor) -> tuple[Tensor, Tensor]:
    """`jackknife` of a fit's own curvature."""
    curvature, score = normal_equations(problem, fit)
    return jackknife(curvature, score, fit.prior**-2, group)


def jackknife(
    curvature: Tensor,
    score: Tensor,
    precision: Tensor,
    group: Tensor,
    information: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """How far the solution moves without each block, and its covariance from that.

    To first order d_g = (H - H_g)^-1 s_g without block g, H with the prior's curvature;
    covariance H^-1 L H^-1 + (G - 1) / G sum_g d_g d_g^T: what the prior alone holds is not known.
    Unlike a sandwich it stays honest where a few blocks decide.

    Args:
        curvature: [N, P, P] of each segment.
        score: [N, P] likewise.
        precision: [P] curvature of the prior's loss.
        group: [N] int, blocks.
        information: [P] L of the prior, that counts as unknown; by default its curvature.

    Returns:
        Moves [N, P] of each segment's block, and the covariance [P, P].
    """
    hessian = curvature.sum(0) + torch.diag(precision)
    inverse = torch.linalg.inv(hessian)
    information = precision if information is None else information
    covariance = inverse @ torch.diag(information) @ inverse
    moves = torch.zeros(len(group), len(precision), dtype=torch.float64)
    names = group.unique()
    for name in names:
        rows = group == name
        move = torch.linalg.solve(hessian - curvature[rows].sum(0), score[rows].sum(0))
        moves[rows] = move
        covariance += (len(names) - 1) / len(names) * torch.outer(move, move)
    return moves, covariance


def advantage(
    noise: NoiseModel, dispersion: float, better: CrossValidated, worse: CrossValidated
) -> float:
    """Of `better` over `worse`, on what was held out [nats]."""
    return float(
        (noise.loss(worse.square, dispersion) - noise.loss(better.square, dispersion)).sum()
    )
