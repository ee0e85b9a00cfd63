"""Damped Gauss-Newton on whitened residuals, of many hypotheses in one batch of rollouts."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from buggy_rl.estimation.hypothesis import AT_BOUND, Hypothesis, Library
from buggy_rl.estimation.noise_model import NoiseModel
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments

STEP = 0.02  # [prior scales] finite difference
LONGEST = 2.0  # [prior scales] step of an iteration, in each coordinate
TRIED = 2  # iterations with all dampings; then hypotheses that gain little are no longer fitted:
HOPELESS = 0.3  # [-] less than this share of what the best one has gained, or
BEHIND = 30.0  # [nats] this far behind the best one, were its expected gain
AHEAD = 3.0  # [-] so many times as large; both chosen
SMALL = 1000  # [environments] of a batch that takes hardly longer than one of a few; chosen
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

    def rewhitened(self, change: Tensor) -> "Fit":
        """Fit under another noise model, by [N, D, D] of `NoiseModel.change_from`."""
        whitened = torch.einsum("nij,nj->ni", change, self.whitened)
        jacobian = None if self.jacobian is None else change @ self.jacobian
        return replace(self, whitened=whitened, jacobian=jacobian)

    def __getitem__(self, rows: Tensor) -> "Fit":
        """Fit on some of the segments."""
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
    known: Mapping[tuple[str, str], Tensor] = field(default_factory=dict)
    """(Effect, parameter) -> derivatives [N, D] of whitened residuals that are taken as they are
    wherever it stands, and not found anew: of numbers that hardly change, such as those of a
    fitted simulator. They need the noise model that they were made with."""

    def __getitem__(self, index: Tensor) -> "Problem":
        """Problem on some of the segments."""
        known = {number: column[index] for number, column in self.known.items()}
        segments, noise = self.segments[index], self.noise[index]
        return replace(self, segments=segments, noise=noise, known=known)

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
        wanted = zip(hypotheses, linear, strict=True)
        steps = [self._differences(h) if one else None for h, one in wanted]
        rows = [
            (h, vector)
            for h, own in zip(hypotheses, steps, strict=True)
            for vector in (h.vector, *(h.vector + step for step in (own or {}).values()))
        ]
        whitened = iter(self.whitened(rows))
        fits = []
        for h, own in zip(hypotheses, steps, strict=True):
            fit = Fit(h.effects, h.coordinates, h.vector, next(whitened))
            fits.append(fit if own is None else self._with_derivatives(fit, own, whitened))
        return fits

    def linearised(self, fits: Sequence[Fit]) -> list[Fit]:
        """Fits with their derivatives; all in one batch."""
        steps = [self._differences(fit) if fit.jacobian is None else None for fit in fits]
        rows = [
            (fit, fit.vector + step)
            for fit, own in zip(fits, steps, strict=True)
            for step in (own or {}).values()
        ]
        moved = iter(self.whitened(rows))
        return [
            fit if own is None else self._with_derivatives(fit, own, moved)
            for fit, own in zip(fits, steps, strict=True)
        ]

    def _differences(self, h: Hypothesis) -> dict[int, Tensor]:
        """A step [P] along each coordinate that is not known, away from its bounds."""
        steps = {}
        for p, c in enumerate(h.coordinates):
            if (c.effect, c.parameter.name) in self.known:
                continue
            step = torch.zeros_like(h.vector)
            step[p] = STEP
            if not torch.equal(h.bounded(h.vector + step), h.vector + step):
                step[p] = -STEP
            steps[p] = step
        return steps

    def _with_derivatives(
        self, fit: Fit, steps: Mapping[int, Tensor], moved: Iterator[Tensor]
    ) -> Fit:
        """Fit with one-sided differences of whitened residuals [N, D], and with what is known."""
        found = {p: (next(moved) - fit.whitened) / float(step.sum()) for p, step in steps.items()}
        columns = [
            found[p] if p in found else self.known[c.effect, c.parameter.name]
            for p, c in enumerate(fit.coordinates)
        ]
        return replace(fit, jacobian=torch.stack(columns, -1))

    def cost(self, fit: Fit) -> float:
        """Loss of all segments and prior penalty [nats]."""
        total = self.noise.loss(fit.square, self.dispersion).sum()
        return float(total + fit.penalty())


def fitted(
    problem: Problem,
    hypotheses: Sequence[Hypothesis],
    iterations: int = 5,
    reference: float | None = None,
    groups: Sequence[int] = (),
    leading: float = math.inf,
) -> list[Fit]:
    """Minimises the cost of each hypothesis; all get their derivatives.

    z <- z - (H + lambda diag H)^-1 g, with the best lambda of `DAMPINGS` by rollouts; after `TRIED`
    iterations with the first, and with the others where that one is no better. A fit ends where no
    step is expected to gain, or where it stays `BEHIND` the best one.

    Args:
        problem: What they are fitted to.
        hypotheses: Where each begins.
        iterations: At most.
        reference: Cost of none of them [nats]. Given one, hypotheses that gain little on it after
            `TRIED` iterations are fitted no further.
        groups: Number of the group of each within which they are compared; none for a single one.
        leading: Cost of another fit that they are compared with [nats].
    """
    groups = groups or [0] * len(hypotheses)
    found = problem.rolled_out([h.at(h.vector) for h in hypotheses], linear=True)
    going = dict.fromkeys(range(len(found)), DAMPINGS)
    for iteration in range(iterations):
        costs = [problem.cost(f) for f in found]
        best = _by_group(costs, groups)
        if reference is not None and iteration >= TRIED:
            going = {
                i: dampings
                for i, dampings in going.items()
                if reference - costs[i] > HOPELESS * (reference - best[groups[i]])
            }
        for i, fit in zip(going, problem.linearised([found[i] for i in going]), strict=True):
            found[i] = fit
        ways = {i: _steps(problem, found[i], dampings) for i, dampings in going.items()}
        steps = {
            i: own.ends
            for i, own in ways.items()
            if iteration < TRIED
            or costs[i] - AHEAD * own.expected < min(leading, best[groups[i]]) + BEHIND
        }
        steps = {i: ends for i, ends in steps.items() if ends}
        if not steps:
            break
        before, going = {i: found[i] for i in steps}, {}
        for i, fit in _best(problem, before, steps).items():
            found[i] = fit
            if _worth(problem.cost(before[i]) - problem.cost(fit), problem.cost(before[i])):
                going[i] = DAMPINGS if iteration + 1 < TRIED else DAMPINGS[:1]
            elif fit is before[i] and len(steps[i]) == 1:
                going[i] = DAMPINGS[1:]
    return problem.linearised(found)


def _by_group(costs: Sequence[float], groups: Sequence[int]) -> dict[int, float]:
    """The least cost of each group."""
    return {g: min(c for c, own in zip(costs, groups, strict=True) if own == g) for g in groups}


def _best(
    problem: Problem, fits: Mapping[int, Fit], steps: Mapping[int, Sequence[Hypothesis]]
) -> dict[int, Fit]:
    """Best of the steps of each fit; the fit itself where none is better.

    The first, which most often is the best, comes with its derivatives; in a small batch all do.
    """
    owners = [i for i, own in steps.items() for _ in own]
    sets = sum(1 + len(trial.coordinates) for own in steps.values() for trial in own)
    small = sets * len(problem.segments) <= SMALL
    linear = [small or number == 0 for own in steps.values() for number in range(len(own))]
    trials = [trial for own in steps.values() for trial in own]
    best = dict(fits)
    for i, other in zip(owners, problem.rolled_out(trials, linear), strict=True):
        if problem.cost(other) < problem.cost(best[i]):
            best[i] = other
    return best


@dataclass(frozen=True, eq=False)
class _Steps:
    """Damped steps from a fit."""

    ends: list[Hypothesis]
    """Hypotheses that they lead to; none where none is expected to gain."""
    expected: float = 0.0
    """[nats] that the best of them is expected to gain."""


def _steps(problem: Problem, fit: Fit, dampings: Sequence[float]) -> _Steps:
    """Steps from a fit, with its derivatives.

    A step that is held by bounds can lead up the parabola, where a damped one leads down: where no
    step that is asked for is expected to gain, those of the other dampings are taken.
    """
    curvature, score = normal_equations(problem, fit)
    hessian = curvature.sum(0) + torch.diag(fit.prior**-2)
    gradient = score.sum(0) + fit.vector / fit.prior**2
    ends, expected = list[Hypothesis](), list[float]()
    for damping in DAMPINGS:
        damped = hessian + damping * torch.diag(hessian.diagonal())
        ends.append(fit.at(fit.vector + _within(fit, damped, gradient)))
        step = ends[-1].vector - fit.vector
        expected.append(-float(step @ gradient + 0.5 * step @ hessian @ step))
    worth = [_worth(gain, problem.cost(fit)) for gain in expected]
    if not any(worth):
        return _Steps([])
    asked = [DAMPINGS.index(damping) for damping in dampings]
    taken = asked if any(worth[i] for i in asked) else range(1, len(ends))
    return _Steps([ends[i] for i in taken], max(expected))


def _within(fit: Hypothesis, hessian: Tensor, gradient: Tensor) -> Tensor:
    """The step [P] to the minimum of a parabola, along what bounds it and `LONGEST`."""
    step, held = torch.zeros_like(gradient), torch.zeros_like(gradient, dtype=torch.bool)
    for _ in gradient:
        free = ~held
        rest = gradient + hessian[:, held] @ step[held]
        step[free] = -torch.linalg.solve(hessian[free][:, free], rest[free])
        within = fit.bounded(fit.vector + step.clamp(-LONGEST, LONGEST)) - fit.vector
        out = free & ((within - step).abs() > AT_BOUND)
        step, held = within, held | out
        if not bool(out.any()) or bool(held.all()):
            break
    return step


def _worth(gain: float, cost: float) -> bool:
    """Whether a decrease of the cost [nats] is worth another step."""
    relative, absolute = CONVERGED
    return gain > relative * max(1.0, abs(cost)) or gain > absolute


def normal_equations(problem: Problem, fit: Fit) -> tuple[Tensor, Tensor]:
    """Curvature [N, P, P] and score [N, P] of each segment's loss, without the prior.

    H_n = w_n J_n^T J_n / phi, s_n = w_n J_n^T r_n / phi, with the loss's weight w.
    """
    assert fit.jacobian is not None
    weight = problem.noise.weight(fit.square, problem.dispersion) / problem.dispersion  # (N,)
    curvature = torch.einsum("ndp,ndq,n->npq", fit.jacobian, fit.jacobian, weight)
    score = torch.einsum("ndp,nd,n->np", fit.jacobian, fit.whitened, weight)
    return curvature, score
