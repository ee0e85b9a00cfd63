"""Damped Gauss-Newton on whitened residuals, of many hypotheses in one batch of rollouts."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from buggy_rl.estimation.hypothesis import Hypothesis, Library
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments

STEP = 0.02  # [prior scales] finite difference
LONGEST = 2.0  # [prior scales] step of an iteration, in each coordinate
TRIED = 2  # iterations after which hypotheses that gain little are no longer fitted:
HOPELESS = 0.3  # [-] less than this share of what the best one has gained
DAMPINGS = (1e-6, 0.1, 10.0)  # [-] of the curvature's diagonal; the first follows a ridge
CONVERGED = (1e-3, 0.5)  # [-] relative, [nats] absolute decrease below both of which a fit ends


@dataclass(frozen=True, eq=False)
class Fit(Hypothesis):
    """A hypothesis and its rollouts."""

    whitened: Tensor
    """[N, D] whitened residuals."""
    jacobian: Tensor | None = None
    """[N, D, P] their derivatives by the coordinates."""

    @property
    def square(self) -> Tensor:
        """|W e|^2 [N] of each segment."""
        return self.whitened.square().sum(-1)

    def __getitem__(self, rows: Tensor) -> "Fit":
        """On some of the segments."""
        jacobian = None if self.jacobian is None else self.jacobian[rows]
        return replace(self, whitened=self.whitened[rows], jacobian=jacobian)


@dataclass(frozen=True, eq=False)
class Problem:
    """What hypotheses are fitted to."""

    simulation: Simulation
    segments: Segments
    noise: NoiseModel
    library: Library
    dispersion: float = 1.0
    """Squares are divided by it: the mean squared standardised residual that is expected."""

    def __getitem__(self, index: Tensor) -> "Problem":
        """On some of the segments."""
        return replace(self, segments=self.segments[index], noise=self.noise[index])

    def whitened(self, rows: Sequence[tuple[Hypothesis, Tensor]]) -> list[Tensor]:
        """Whitened residuals [N, D] of hypotheses at vectors [P], or [N, P] by segment."""
        if not rows:
            return []
        residuals = self.simulation.residuals(self.segments, self.library.settings(rows))
        return list(self.noise.whiten(residuals))

    def rolled_out(
        self, hypotheses: Sequence[Hypothesis], linear: Sequence[bool] | bool = False
    ) -> list[Fit]:
        """Hypotheses with their residuals, not fitted; where `linear`, with their derivatives.

        All in one batch: it takes little longer than one hypothesis, which is why derivatives are
        asked for here as soon as they are likely to be needed.
        """
        if isinstance(linear, bool):
            linear = [linear] * len(hypotheses)
        steps = [_differences(h) if one else [] for h, one in zip(hypotheses, linear, strict=True)]
        rows = [
            (h, vector)
            for h, own in zip(hypotheses, steps, strict=True)
            for vector in (h.vector, *(h.vector + step for step in own))
        ]
        whitened = iter(self.whitened(rows))
        fits = []
        for h, own in zip(hypotheses, steps, strict=True):
            fit = Fit(h.effects, h.coordinates, h.vector, next(whitened))
            fits.append(_with_derivatives(fit, own, [next(whitened) for _ in own]))
        return fits

    def cost(self, fit: Fit) -> float:
        """Loss of all segments and prior penalty [nats]."""
        total = self.noise.loss(fit.square, self.dispersion).sum()
        return float(total + fit.penalty())


def fitted(
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    iterations: int = 5,
    reference: float | None = None,
) -> list[Fit]:
    """Minimises the cost of each hypothesis; all get their derivatives.

    z <- z - (H + lambda diag H)^-1 g, with lambda the best of `DAMPINGS` by rollouts.

    Args:
        problem: What they are fitted to.
        hypotheses: Where each begins.
        iterations: At most.
        reference: Cost of none of them [nats]. Given one, hypotheses that gain little on it after
            `TRIED` iterations are fitted no further.
    """
    found = problem.rolled_out([h.at(h.vector) for h in hypotheses], linear=True)
    active = list(range(len(found)))
    for iteration in range(iterations):
        if reference is not None and iteration >= TRIED:
            gains = [reference - problem.cost(f) for f in found]
            active = [i for i in active if gains[i] > HOPELESS * max(gains)]
        if not active:
            break
        for i, fit in zip(active, linearised(problem, [found[i] for i in active]), strict=True):
            found[i] = fit
        best = _best_steps(problem, [found[i] for i in active])
        moved = []
        for i, other in zip(active, best, strict=True):
            before, after = problem.cost(found[i]), problem.cost(other)
            found[i] = other
            relative, absolute = CONVERGED
            if before - after > relative * max(1.0, abs(before)) or before - after > absolute:
                moved.append(i)
        active = moved
    return linearised(problem, found)


def _best_steps(problem: Problem, fits: Sequence[Fit]) -> list[Fit]:
    """The best of each fit's damped steps; the fit itself where none is better.

    The longest, which most often is the best, comes with its derivatives.
    """
    owners, trials, longest = [], [], []
    for index, fit in enumerate(fits):
        for number, vector in enumerate(_steps(problem, fit)):
            owners.append(index)
            trials.append(fit.at(vector))
            longest.append(number == 0)
    best = list(fits)
    for index, other in zip(owners, problem.rolled_out(trials, longest), strict=True):
        if problem.cost(other) < problem.cost(best[index]):
            best[index] = other
    return best


def _steps(problem: Problem, fit: Fit) -> Iterator[Tensor]:
    curvature, score = normal_equations(problem, fit)
    hessian = curvature.sum(0) + torch.diag(fit.prior**-2)
    gradient = score.sum(0) + fit.vector / fit.prior**2
    for damping in DAMPINGS:
        damped = hessian + damping * torch.diag(hessian.diagonal())
        yield fit.vector - torch.linalg.solve(damped, gradient).clamp(-LONGEST, LONGEST)


def linearised(problem: Problem, fits: Sequence[Fit]) -> list[Fit]:
    """Fits with their derivatives; all in one batch."""
    steps = [_differences(fit) if fit.jacobian is None else [] for fit in fits]
    rows = [(fit, fit.vector + s) for fit, own in zip(fits, steps, strict=True) for s in own]
    moved = iter(problem.whitened(rows))
    return [
        _with_derivatives(fit, own, [next(moved) for _ in own])
        for fit, own in zip(fits, steps, strict=True)
    ]


def _differences(fit: Hypothesis) -> list[Tensor]:
    """A step [P] along each coordinate, away from its bounds."""
    steps = []
    for p in range(len(fit.vector)):
        step = torch.zeros_like(fit.vector)
        step[p] = STEP
        if not torch.equal(fit.bounded(fit.vector + step), fit.vector + step):
            step[p] = -STEP
        steps.append(step)
    return steps


def _with_derivatives(fit: Fit, steps: Sequence[Tensor], moved: Sequence[Tensor]) -> Fit:
    """By one-sided differences, from whitened residuals [N, D] at each step; as it is without."""
    if not steps:
        return fit
    columns = [(m - fit.whitened) / float(s.sum()) for m, s in zip(moved, steps, strict=True)]
    return replace(fit, jacobian=torch.stack(columns, -1))


def normal_equations(problem: Problem, fit: Fit) -> tuple[Tensor, Tensor]:
    """Curvature [N, P, P] and score [N, P] of each segment's loss, without the prior.

    H_n = w_n J_n^T J_n / phi, s_n = w_n J_n^T r_n / phi, with the loss's weight w.
    """
    assert fit.jacobian is not None
    weight = problem.noise.weight(fit.square, problem.dispersion) / problem.dispersion  # (N,)
    curvature = torch.einsum("ndp,ndq,n->npq", fit.jacobian, fit.jacobian, weight)
    score = torch.einsum("ndp,nd,n->np", fit.jacobian, fit.whitened, weight)
    return curvature, score
