"""Evidence of a hypothesis, given that the simulator is wrong in everything a little.

    r + J d + S b + V u = n,   d ~ N(-z, sd^2),  b ~ N(0, spread^2),  u ~ N(0, variation^2),
    n ~ N(0, phi)

with r the whitened residual of a fit at z, J its derivative, S a column for each other effect (a
simulator of other form differs from the car by a little of each), and V = J z c_n a column for each
condition c_n of the drive (a misspecified effect is another at another speed). All three kinds of
coefficients are shared by all segments, so that one common error does not count in each of them
again. Integrated over d, b and u; spread, variation and phi are those of the largest evidence
(type II maximum likelihood: MacKay 1992).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fit, Problem, normal_equations
from buggy_rl.estimation.noise_model import HEAVY, NoiseModel
from buggy_rl.estimation.segments import Segments

INDEPENDENT = 0.25  # [-] share of the numbers of a segment that counts: its errors grow together
SPREADS = (0.0, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35)  # [prior scales] tried
VARIATIONS = (0.0, 0.05, 0.1, 0.2, 0.4)  # [of the effect] tried
DISPERSIONS = torch.logspace(0, 3, 31, dtype=torch.float64)  # [noise variances] tried


@dataclass(frozen=True)
class Evidence:
    """Evidence of one hypothesis."""

    log_evidence: float
    """[nats] at the best spread, variation and dispersion."""
    spread: float
    """[prior scales] standard deviation of the other effects."""
    variation: float
    """[-] of the effect's numbers with each condition."""
    dispersion: float
    """[noise variances] what nothing explains."""
    plain: float
    """[nats] without spread and variation."""
    by_spread: float
    """[nats] that spread alone gains on `plain`."""
    by_variation: float
    """[nats] that variation alone gains on `plain`."""
    numbers: float
    """[-] independent ones that were counted."""


def evidence(fit: Fit, others: Tensor, conditions: Tensor) -> Evidence:
    """The evidence of a fit.

    Args:
        fit: With its derivatives.
        others: [N, D, Q] change of the whitened residuals by one prior scale of each other effect.
        conditions: [N, C] of each segment, in standard deviations about their median.
    """
    assert fit.jacobian is not None
    size = fit.whitened.shape[-1]
    own = [i for i, coordinate in enumerate(fit.coordinates) if coordinate.effect]
    varying = fit.jacobian[..., own] * fit.vector[own]  # (N, D, P)
    varying = (varying.unsqueeze(-1) * conditions[:, None, None, :]).flatten(2)  # (N, D, P C)
    columns = torch.cat([fit.jacobian, others, varying], -1)
    typical = max(1.0, float((fit.square / size).median()))
    # Where a car spins a segment counts for less, as in the loss.
    weight = INDEPENDENT / (1 + fit.square / (typical * HEAVY * size))  # (N,)
    gram = torch.einsum("ndp,ndq,n->pq", columns, columns, weight)
    along = torch.einsum("ndp,nd,n->p", columns, fit.whitened, weight)
    left, numbers = float((weight * fit.square).sum()), float(weight.sum()) * size
    kinds = [len(fit.coordinates), others.shape[-1], varying.shape[-1]]
    centre = torch.zeros(sum(kinds), dtype=torch.float64)
    centre[: kinds[0]] = -fit.vector

    def at(spread: float, variation: float) -> tuple[float, float]:
        sizes = (torch.full((n,), s) for n, s in zip(kinds[1:], (spread, variation), strict=True))
        sd = torch.cat([fit.prior, *sizes]).double()
        return _integrated(gram, along, left, numbers, sd, centre)

    table = {(s, v): at(s, v) for s in SPREADS for v in VARIATIONS}
    best = max(table, key=lambda key: table[key][0])
    plain = table[0.0, 0.0][0]
    return Evidence(
        log_evidence=table[best][0],
        spread=best[0],
        variation=best[1],
        dispersion=table[best][1],
        plain=plain,
        by_spread=max(table[s, 0.0][0] for s in SPREADS) - plain,
        by_variation=max(table[0.0, v][0] for v in VARIATIONS) - plain,
        numbers=numbers,
    )


def _integrated(
    gram: Tensor, along: Tensor, left: float, numbers: float, sd: Tensor, centre: Tensor
) -> tuple[float, float]:
    """Log evidence at the best dispersion, and that.

    With x = sd y, A = sd G sd, m = centre / sd (where sd > 0), g = sd along / phi - m:
    -1/2 (left / phi + m^2 - g^T (A / phi + 1)^-1 g + log det(1 + A / phi) + numbers log phi).
    """
    values, vectors = torch.linalg.eigh(sd.unsqueeze(1) * gram * sd)
    values = values.clamp_min(0.0)
    middle = torch.where(sd > 0, centre / sd.clamp_min(1e-12), torch.zeros_like(sd))
    phi = DISPERSIONS.unsqueeze(1)  # (F, 1)
    g = (vectors.mT @ (sd * along)) / phi - vectors.mT @ middle  # (F, P)
    ratio = values / phi
    exponent = left / phi.squeeze(1) + middle.square().sum() - (g.square() / (1 + ratio)).sum(1)
    total = -0.5 * (exponent + torch.log1p(ratio).sum(1) + numbers * phi.squeeze(1).log())
    best = int(total.argmax())
    return float(total[best]), float(DISPERSIONS[best])


FARTHEST = 1e4  # [noise variances] as which a segment counts at most


def closeness(square: Tensor) -> Tensor:
    """Log of how far segments are from what was measured, of their |W e|^2 / D; 0 for nothing."""
    return 0.5 * torch.log1p(square.clamp_max(FARTHEST))


NOTHING = 0.05  # [noise sd] excess misfit below which nothing is left to explain
CAP = 100.0  # [noise variances] as which a segment counts at most: spins end far apart


def misfit(square: Tensor, given: Tensor | None = None) -> float:
    """Mean of |W e| / sqrt(D) of segments, each counted as sqrt(`CAP`) at most.

    A segment in which a car spins weighs no more than the cap, but counts as closed by as much as
    it is: with `given`, m = mean(1 + w (r - 1)), w = min(1, (sqrt(CAP) - 1) / (r_given - 1)).

    Args:
        square: [N] |W e|^2 / D.
        given: [N] likewise of the simulator as given, where it is compared with that.
    """
    root, most = square.sqrt(), CAP**0.5
    if given is None:
        # Where most segments are beyond the cap, the median is what is typical.
        return max(float(root.clamp_max(most).mean()), float(root.median()))
    weight = ((most - 1) / (given.sqrt() - 1).clamp_min(1e-9)).clamp_max(1.0)
    return float((1 + weight * (root - 1)).clamp_max(most).mean())


@dataclass(frozen=True)
class BaselineMisfit:
    """Excess misfit of a simulator on recordings on which it counts as right."""

    mean: float = 0.0
    """Mean excess misfit; below 0 where the sensor is less noisy than it is taken for."""
    error: float = 0.0
    """Standard error of the mean over as many blocks as the new recordings have."""

    @property
    def most(self) -> float:
        """Excess misfit within which new recordings are as right as those."""
        return max(NOTHING, self.mean + 3 * self.error)

    def beyond(self, excess: float) -> float:
        """Expected excess misfit over this, where there cannot be less than none.

        E[max(0, x)], x ~ N(excess - mean, error^2): over Phi(over / error) + error phi(over /
        error), over = excess - mean.
        """
        over, error = excess - self.mean, self.error
        if error <= 0:
            return max(0.0, over)
        ratio = over / error
        below = 0.5 * math.erfc(ratio / math.sqrt(2))
        return over * (1 - below) + error * math.exp(-0.5 * ratio**2) / math.sqrt(2 * math.pi)

    def remaining(self, excess: float, closed: float) -> float:
        """What remains beyond this over what an effect closes, 1 at most.

        Args:
            excess: Excess misfit of a hypothesis.
            closed: Excess misfit that comes back without one of its effects.
        """
        rest = max(0.0, excess - self.mean) + 2 * self.error
        return min(1.0, max(rest, NOTHING) / max(closed, 1e-9))


NO_BASELINE = BaselineMisfit()


def baseline_misfit(square: Tensor, group: Tensor, others: int) -> BaselineMisfit:
    """Misfit by the spread between blocks: what a simulator gets wrong differs between recordings.

    Args:
        square: [N] |W e|^2 / D of segments of baseline recordings.
        group: [N] their blocks.
        others: Blocks of the new recordings.
    """
    root = square.clamp_max(CAP).sqrt()
    means = torch.stack([root[group == g].mean() for g in group.unique()])
    spread = float(means.std()) if len(means) > 1 else 0.0
    return BaselineMisfit(float(means.mean()) - 1, spread / others**0.5)


def typical(square: Tensor) -> float:
    """Median of |W e|^2 / D of segments [N]."""
    return float(square.median())


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


def mean_of_blocks(values: Tensor, group: Tensor) -> tuple[float, float]:
    """Mean of values [N] block by block [N], and its standard error; infinite of a single block."""
    means = torch.stack([values[group == number].mean() for number in group.unique()])
    if len(means) < 2:
        return float(means.mean()), float("inf")
    return float(means.mean()), float(means.std() / len(means) ** 0.5)


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
    """Cross-validation under another noise model, without a rollout: at the same numbers.

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
    """Advantage of `better` over `worse`, on what was held out [nats]."""
    return float(
        (noise.loss(worse.square, dispersion) - noise.loss(better.square, dispersion)).sum()
    )
