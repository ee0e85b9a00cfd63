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

from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.estimation.gauss_newton import Fit
from buggy_rl.estimation.noise_model import HEAVY

INDEPENDENT = 0.25  # [-] share of the numbers of a segment that counts: its errors grow together
SPREADS = (0.0, 0.02, 0.04, 0.07, 0.12, 0.2, 0.35)  # [prior scales] tried
VARIATIONS = (0.0, 0.05, 0.1, 0.2, 0.4)  # [of the effect] tried
DISPERSIONS = torch.logspace(0, 3, 31, dtype=torch.float64)  # [noise variances] tried


@dataclass(frozen=True)
class Evidence:
    """Of one hypothesis."""

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
