"""Validation: how far rollouts are from recordings that nothing was fitted to.

Commands act when they are stamped, since a simulator's file holds no clock: what is validated is
what is delivered.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.diagnosis.run.budget import FULL, Budget
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import Effect
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.estimation.baseline import lacking_acceleration, trained
from buggy_rl.estimation.evidence import BLOCK, blocks
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import OWN, Hypothesis, Library
from buggy_rl.estimation.rollout import AS_GIVEN, ParameterSets, Simulation
from buggy_rl.estimation.segments import HORIZONS, Segments

SAID = 1.0  # [s] horizon of the errors that are said


FOLDS = 2
ITERATIONS = 2  # of a fit to a part of the recordings, from the one to all of them
TRIMS = ("throttle_gain", "throttle_offset", "steering_gain", "steering_offset")
"""What anyone would turn at to make a simulator fit that has no parameters of its own."""


@dataclass
class Errors:
    """Distances of rollouts from what was measured, by horizon [s]."""

    mean_square: dict[float, float] = field(default_factory=dict)
    """Mean square over segments and over time up to the horizon [m^2], the original's equation
    5.2."""
    median: dict[float, float] = field(default_factory=dict)
    """Median over segments of the root of each one's own mean square [m]."""
    square: Tensor = field(default_factory=lambda: torch.empty(0))
    """|W e|^2 / D [N] of the segments that are fitted to, each when it was held out."""

    def add(self, square: Tensor, instants: Tensor, dt: float) -> None:
        """Counts squared distances [N, K] at all horizons that they reach.

        One segment in which a car spins outweighs a hundred others in a mean square; in the median
        it does not.
        """
        for horizon in HORIZONS:
            within = instants <= round(horizon / dt)
            if int(instants[-1]) >= round(horizon / dt) and len(square):
                of_segment = square[:, within].mean(1)
                self.mean_square[horizon] = float(of_segment.mean())
                self.median[horizon] = float(of_segment.sqrt().median())


def validated(
    problem: Problem,
    best: Hypothesis,
    longer: Mapping[float, Segments] | None = None,
    budget: Budget = FULL,
    others: Mapping[str, Hypothesis] | None = None,
) -> dict[str, Errors]:
    """Errors of rollouts over recordings, or blocks of them, that nothing was fitted to.

    Args:
        problem: What `best` was fitted to.
        best: The hypothesis; fitted anew for each fold that is held out, its clock left out.
        longer: Horizon [s] -> longer segments of the same recordings.
        budget: Whether horizons beyond the segments count too, and iterations of a fit.
        others: Name -> further hypotheses, treated like `best`.

    Returns:
        `before`: as given. `after`: with the effects. `retuned`: with the simulator's own
        parameters fitted instead, or `TRIMS` where it declares none. `black_box`: with a network
        instead that was trained on the accelerations it lacks. Besides, those of `others`.
    """
    fold = segment_folds(problem.segments)
    aside = [torch.nonzero(fold == n).flatten() for n in range(int(fold.max()) + 1)]
    starts = {"after": best, **(others or {})}
    own = _retunable(problem.library)
    if own:
        starts["retuned"] = problem.library.at(own, best.named())
    starts = {name: start.as_stamped for name, start in starts.items()}
    begun = time.perf_counter()
    networks = _networks(problem, aside)
    apart = partial(problem.simulation.apart, seconds=time.perf_counter() - begun)
    sets = {"before": [problem.library.hypothesis(())] * len(aside)}
    iterations = min(ITERATIONS, budget.iterations)
    sets |= _refits(problem, starts, aside, iterations, apart)
    parts, tasks = [], []
    longer = (longer or {}) if budget.longer else {}
    # Of longer segments no more than of those that are fitted to.
    for part in (problem.segments, *(s.spread(len(problem.segments)) for s in longer.values())):
        owner = _owners(part, problem.segments, fold)
        part, owner = part[owner >= 0], owner[owner >= 0]
        # Each segment at the vector of the fit that it was held out of.
        rows = [(fits[0], torch.stack([f.vector for f in fits])[owner]) for fits in sets.values()]
        parts.append(part)
        tasks += [(part, problem.library.settings(rows), ()), (part, AS_GIVEN, networks(owner))]
    rolled = iter(apart(_residuals, tasks))
    result = {name: Errors() for name in (*sets, "black_box")}
    for number, part in enumerate(parts):
        instants = problem.simulation.instants(part)
        for name, residual in zip(result, (*next(rolled), *next(rolled)), strict=True):
            result[name].add(residual[..., :2].square().sum(-1), instants, part.dt)
            if number == 0 and name in sets:  # what is fitted to
                whitened = problem.noise.whiten(residual.unsqueeze(0))[0]
                result[name].square = whitened.square().mean(-1)
    return result


def delivered(
    problem: Problem, best: Hypothesis, iterations: int = ITERATIONS
) -> tuple[Hypothesis, Errors]:
    """A hypothesis as a simulator's file can hold it, and how far its rollouts are.

    Args:
        problem: Segments that it is fitted to, all of them.
        best: Where the fit begins; its clock is left out.
        iterations: Of the fit.

    Returns:
        The hypothesis, and errors over the same segments: those of the file itself.
    """
    start = best.as_stamped
    [fit] = _fitted(problem, [start], iterations)
    settings = problem.library.settings([(fit, fit.vector)])
    [residual] = problem.simulation.residuals(problem.segments, settings)
    errors, instants = Errors(), problem.simulation.instants(problem.segments)
    errors.add(residual[..., :2].square().sum(-1), instants, problem.segments.dt)
    return fit, errors


def _residuals(
    simulation: Simulation, part: Segments, settings: ParameterSets, standing: Sequence[Effect]
) -> Tensor:
    """Residuals [C, N, K, 6], with further effects."""
    beside = (*simulation.standing, *standing)
    return replace(simulation, standing=beside).residuals(part, settings)


def segment_folds(segments: Segments) -> Tensor:
    """Fold [N] of each segment: whole recordings where there are several, else blocks in turn."""
    recordings = segments.recording.unique()
    if len(recordings) >= FOLDS:
        rank = {int(r): i % FOLDS for i, r in enumerate(recordings)}
        return torch.tensor([rank[int(r)] for r in segments.recording])
    return blocks(segments) % FOLDS


def _retunable(library: Library) -> tuple[str, ...]:
    own = tuple(OWN + name for name in library.parameters if library.own)
    return own or tuple(n for n in TRIMS if n in library.effects and effect_class(n).declared)


def _refits(
    problem: Problem,
    starts: Mapping[str, Hypothesis],
    aside: Sequence[Tensor],
    iterations: int,
    apart: Callable[..., list[Any]],
) -> dict[str, list[Hypothesis]]:
    """Hypotheses fitted anew to all that is not held out, for each fold that is."""
    alone = replace(problem, simulation=problem.simulation.alone)
    first = partial(_refit, alone, list(starts.values()), iterations)
    by_fold = apart(first, [(_rest(problem.segments, rows),) for rows in aside])
    return {name: [fits[k] for fits in by_fold] for k, name in enumerate(starts)}


def _refit(
    problem: Problem,
    starts: Sequence[Hypothesis],
    iterations: int,
    simulation: Simulation,
    rows: Tensor,
) -> list[Hypothesis]:
    """Hypotheses fitted to some of the segments."""
    return _fitted(replace(problem, simulation=simulation)[rows], starts, iterations)


def _fitted(problem: Problem, starts: Sequence[Hypothesis], iterations: int) -> list[Hypothesis]:
    """Hypotheses fitted; one without numbers stays as it is."""
    free = [start for start in starts if len(start.vector)]
    fits = iter(fitted(problem, free, iterations) if free else ())
    return [_plain(next(fits)) if len(start.vector) else start for start in starts]


def _plain(fit: Hypothesis) -> Hypothesis:
    """A fit without its rollouts."""
    return Hypothesis(fit.effects, fit.coordinates, fit.bounded(fit.vector))


def _networks(
    problem: Problem, aside: Sequence[Tensor]
) -> Callable[[Tensor], list[ResidualAcceleration]]:
    """A network for each fold that is held out, which learned from the rest.

    Returns:
        Gives for folds [N] effects of which each environment has that of its fold.
    """
    inputs, lacking = lacking_acceleration(problem.simulation, problem.segments)
    dt = problem.segments.dt
    rests = [_rest(problem.segments, rows) for rows in aside]
    learned = [trained(inputs[rest], lacking[rest], 0) for rest in rests]

    def of_folds(owner: Tensor) -> list[ResidualAcceleration]:
        return [
            ResidualAcceleration(model=network, dt=dt).with_parameters(
                TensorDict({"strength": (owner == n).float()}, [len(owner)])
            )
            for n, network in enumerate(learned)
        ]

    return of_folds


def _rest(segments: Segments, aside: Tensor) -> Tensor:
    """Rows that are not set aside; of a single block, which proves nothing, all."""
    kept = torch.ones(len(segments), dtype=torch.bool)
    kept[aside] = False
    return torch.nonzero(kept if bool(kept.any()) else ~kept).flatten()


def _owners(part: Segments, segments: Segments, fold: Tensor) -> Tensor:
    """Fold [N] of segments of another length; -1 where their block has none."""
    owner = dict(zip(_blocks(segments), fold.tolist(), strict=True))
    return torch.tensor([owner.get(block, -1) for block in _blocks(part)])


def _blocks(segments: Segments) -> list[tuple[int, int]]:
    block = (segments.row.double() * segments.dt / BLOCK).long()
    return list(zip(segments.recording.tolist(), block.tolist(), strict=True))
