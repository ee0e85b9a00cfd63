"""Each effect of the library fitted alone, and the best of them, or nothing, by a criterion.

The fits are rollouts by the package's own Gauss-Newton along the segments of the diagnosis. Both
criteria are in nats, the less the better, with N segments of D numbers, k free numbers beside the
clock, and M effects to choose from:

    BIC / 2          L(r) + k / 2 ln(N D) + ln C(M, m)
    held-out density L(r of each block, by a fit to the others) + ln C(M, m)
    L(r)             min over phi of  sum (h + D) / 2 ln(1 + |r|^2 / (phi h)) + N D / 2 ln phi

L is the density that belongs to the loss of the diagnosis, Student's t of h degrees of freedom, at
its best dispersion. The last term, of m effects that are named, is that of the extended BIC (Chen &
Chen 2008): among fifty effects one fits better than nothing by chance. An effect that is under a
tenth of its prior scale is no candidate: smoothed starts alone bring about so much.
"""

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.estimation.evidence import DISPERSIONS, CrossValidated, cross_validated
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.noise_model import HEAVY, NoiseModel
from buggy_rl.estimation.sparse import screened, thinned
from buggy_rl.proof.baselines.asked import (
    Asked,
    Numbers,
    named,
    open_question,
    parameter_interval,
    unnamed,
)
from buggy_rl.proof.baselines.retune import MOVED

SCREENED = 16  # segments on which every effect is fitted; chosen for the run time
SIZES = (0.7,)  # [prior scales] from neutral, to either side, at which such a fit begins
FIRST = 2  # Gauss-Newton iterations of such a fit
KEPT = 8  # effects, the best by such fits, that are fitted to all segments
ITERATIONS = 3  # Gauss-Newton iterations of a fit to all segments


@dataclass(frozen=True, eq=False)
class Singles:
    """Fits of nothing and of the best effects, with their cross-validation in the same order."""

    problem: Problem
    """Problem at the dispersion that the best of them leaves."""
    fits: Sequence[Fit]
    """Nothing, then effects from the one that fits best."""
    held_out: Sequence[CrossValidated]

    @property
    def count(self) -> int:
        """Effects to choose from (M)."""
        return len(self.problem.library.effects)

    @property
    def bic(self) -> list[float]:
        """Half of the extended BIC of each [nats]."""
        return [half_bic(self.problem, fit) for fit in self.fits]

    @property
    def density(self) -> list[float]:
        """Negative logarithm of each one's held-out density, extended likewise [nats]."""
        noise = self.problem.noise
        return [
            least_loss(noise, found.square) + choices(self.count, len(fit.effects))
            for fit, found in zip(self.fits, self.held_out, strict=True)
        ]


@lru_cache(maxsize=1)
def single_fits(asked: Asked) -> Singles:
    """Fits every effect of a case's library alone; kept for one case.

    A simulator such as MuJoCo takes minutes for fifty effects on sixty segments: all are fitted to
    `SCREENED` of them, and the best to all.
    """
    ready = asked.ready
    library = copy(ready.problem.library)
    library.own = False  # parameters of the simulator's own are no effects
    problem = replace(ready.problem, library=library)
    [null] = fitted(problem, [library.hypothesis(())], ITERATIONS)
    problem = replace(problem, dispersion=expected(null, DEFAULTS.expected_left))
    [null] = fitted(problem, [null], ITERATIONS)
    few, [thin] = thinned(problem, SCREENED, [null])
    starts = screened(few, thin, len(library.effects), SIZES)
    first = fitted(few, starts, FIRST, reference=few.cost(thin))
    first.sort(key=lambda fit: half_bic(few, fit))
    problem = replace(problem, dispersion=expected(first[0]))
    found = fitted(problem, first[:KEPT], ITERATIONS)
    fits = [null, *sorted(found, key=lambda fit: half_bic(problem, fit))]
    return Singles(problem, fits, cross_validated(problem, fits, ready.criteria.group))


def with_one_more(problem: Problem, chosen: Fit, keep: int) -> list[Fit]:
    """The most promising sets of one effect more, fitted at the dispersion that is left."""
    problem = replace(problem, dispersion=expected(chosen))
    few, [thin] = thinned(problem, SCREENED, [chosen])
    return fitted(problem, screened(few, thin, keep, SIZES), ITERATIONS)


def expected(fit: Fit, share: float = 1.0) -> float:
    """Dispersion of what a fit leaves, or of a share of it; that of noise at least."""
    return max(1.0, share * float(fit.square.median()) / fit.whitened.shape[-1])


def least_loss(noise: NoiseModel, square: Tensor) -> float:
    """L [nats] of segments with |W e|^2 = `square` [N], at its best dispersion."""
    half, normalised = 0.5 * len(square) * noise.dimension, 1 + 1 / HEAVY  # (h + D) / h
    return min(
        normalised * float(noise.loss(square, phi).sum()) + half * math.log(phi)
        for phi in DISPERSIONS.tolist()
    )


def half_bic(problem: Problem, fit: Fit) -> float:
    """Half of the extended BIC of a fit [nats]."""
    free, size = len(fit.coordinates) - 1, fit.whitened.numel()
    return (
        least_loss(problem.noise, fit.square)
        + 0.5 * free * math.log(size)
        + choices(len(problem.library.effects), len(fit.effects))
    )


def choices(count: int, taken: int) -> float:
    """Logarithm of the number of sets of so many effects [nats]."""
    return math.log(math.comb(count, taken))


def by_bic(seen: Path) -> dict[str, Any]:
    """Names the effect with the lowest BIC, unless nothing has a lower one.

    The confidence is the share exp(-BIC / 2) among all that were fitted, the interval that of the
    fit, by leaving out one block at a time.
    """
    singles = single_fits(open_question(seen))
    return _best(singles, singles.bic)


def by_held_out_density(seen: Path) -> dict[str, Any]:
    """Names the effect under which blocks that were held out are likeliest, or nothing.

    The confidence is the share of that density among all that were fitted, the interval that of the
    fit, by leaving out one block at a time.
    """
    singles = single_fits(open_question(seen))
    return _best(singles, singles.density)


def large(fits: Sequence[Fit]) -> list[Fit]:
    """Fits of which every effect has a number of `MOVED` prior scales at least."""
    return [fit for fit in fits if all(_size(fit, name) >= MOVED for name in fit.effects)]


def _size(fit: Fit, effect: str) -> float:
    """Largest number of an effect [prior scales]."""
    return max(
        abs(z)
        for c, z in zip(fit.coordinates, fit.vector.tolist(), strict=True)
        if c.effect == effect
    )


def _best(singles: Singles, criterion: Sequence[float]) -> dict[str, Any]:
    value = dict(zip(singles.fits, criterion, strict=True))
    nothing, *effects = large(singles.fits)
    best = min([nothing, *effects], key=value.__getitem__)
    if best is nothing:
        behind = min((value[fit] for fit in effects), default=math.inf) - value[nothing]
        return unnamed("no_mismatch", f"the best effect is {behind:.1f} nats worse than nothing")
    scores = torch.tensor([-value[fit] for fit in (best, nothing, *effects)], dtype=torch.float64)
    share = float(torch.exp(scores[0] - scores[1:].logsumexp(0)))
    [name] = best.effects
    covariance = singles.held_out[singles.fits.index(best)].covariance
    note = f"{value[nothing] - value[best]:.1f} nats better than nothing"
    return named("missing_physics", name, share, numbers_of(best, name, covariance), [note])


def numbers_of(fit: Fit, effect: str, covariance: Tensor) -> Numbers:
    """Values of an effect's parameters with their 95 % intervals, by a covariance [P, P]."""
    spread = covariance.diagonal().clamp_min(0.0).sqrt().tolist()
    rows = zip(fit.coordinates, fit.vector.tolist(), spread, strict=True)
    return {
        c.parameter.name: parameter_interval(c.parameter, z, sd)
        for c, z, sd in rows
        if c.effect == effect
    }
