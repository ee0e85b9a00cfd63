"""Validation: how far rollouts are from recordings that nothing was fitted to.

Commands act when they are stamped, since a simulator's file holds no clock: what is validated is
what is delivered.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import torch
from torch import Tensor

from buggy_rl.diagnosis.run.budget import FULL, Budget
from buggy_rl.diagnosis.run.case import Plenty
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import Effect
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.effects.residual_models import Residual, ResidualProcess, ResidualSum
from buggy_rl.estimation.evidence import BLOCK, blocks
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import OWN, Hypothesis, Library
from buggy_rl.estimation.noise_model import NoiseModel, drawn_errors
from buggy_rl.estimation.residual_process import (
    Learned,
    Recipe,
    Rows,
    by_row,
    learned,
    relearned,
)
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import HORIZONS, Segments, segments_joined

SAID = 1.0  # [s] horizon of the errors that are said


FOLDS = 2
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
    sensed: Tensor = field(default_factory=lambda: torch.empty(0))
    """The same [N] by the sensor's noise alone, whatever is usual on a baseline."""
    distance: Tensor = field(default_factory=lambda: torch.empty(0))
    """Root mean square distance [N] of them up to `SAID` [m]."""

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


@dataclass(frozen=True, eq=False)
class HeldOutResiduals:
    """Learned residuals of folds that are held out, each learned from the rest."""

    models: Sequence[ResidualProcess]
    recipe: Recipe

    def effect(self, owner: Tensor, dt: float) -> ResidualAcceleration:
        """The residual of which each environment has that of its fold `owner` [N]."""
        model = by_row(self.models, owner)
        return ResidualAcceleration(model=model, strength=1.0, dt=dt)


class Validation:
    """Rollouts over recordings, or blocks of them, that nothing was fitted to.

    Args:
        problem: What hypotheses were fitted to.
        longer: Horizon [s] -> longer segments of the same recordings.
        budget: Whether horizons beyond the segments count too, and iterations of a fit.
        plenty: Segments that a residual learns from, of the same recordings; those of the problem
            by default.
    """

    def __init__(
        self,
        problem: Problem,
        longer: Mapping[float, Segments] | None = None,
        budget: Budget = FULL,
        plenty: Plenty | None = None,
    ) -> None:
        self.problem = problem
        self._sensor = problem.noise.of_sensor
        self.iterations = budget.iterations
        fold = segment_folds(problem.segments)
        self.aside = [torch.nonzero(fold == n).flatten() for n in range(int(fold.max()) + 1)]
        self.parts: list[tuple[Segments, Tensor]] = []
        """Segments of one length, and the fold [N] that each was held out in."""
        longer = (longer or {}) if budget.longer else {}
        # Of longer segments no more than of those that are fitted to.
        for part in (problem.segments, *(s.spread(len(problem.segments)) for s in longer.values())):
            self.parts.append(_owned(part, problem.segments, fold))
        self.plenty = plenty or Plenty(problem.segments)
        self.to_learn = _owned(self.plenty.segments, problem.segments, fold)
        """Segments that a residual learns from, and the fold [N] of each."""

    def refitted(
        self, starts: Mapping[str, Hypothesis], seconds: float = math.inf
    ) -> dict[str, list[Hypothesis]]:
        """Hypotheses fitted anew for each fold that is held out, their clocks left out.

        Parameters of the simulator's own begin as it is given: many of them are hardly determined,
        and a fit that began near what all recordings say would keep what the held-out ones said.

        Args:
            starts: Name -> where a fit begins.
            seconds: That a fold is expected to take.
        """
        apart = partial(self.problem.simulation.apart, seconds=seconds)
        begun = {name: _begun(start.as_stamped) for name, start in starts.items()}
        return _refits(self.problem, begun, self.aside, self.iterations, apart)

    def residuals(self, fits: Sequence[Hypothesis] | None = None) -> HeldOutResiduals:
        """A residual for each fold that is held out, which learned from the rest.

        Args:
            fits: For each fold the hypothesis in place while it learns; the simulator as given by
                default.
        """
        problem, every = self.problem, range(len(self.aside))
        fits = fits or [problem.library.hypothesis(()).as_stamped for _ in every]
        segments, owner = self.to_learn
        rests = [_rest(segments, torch.nonzero(owner == k).flatten()) for k in every]
        group = torch.cat([torch.full((len(rest),), k) for k, rest in enumerate(rests)])
        aside, own = (
            torch.cat(self.aside),
            torch.cat([torch.full((len(rows),), k) for k, rows in enumerate(self.aside)]),
        )
        library = problem.library
        held_out = rows_to_learn(library, fits, problem.segments[aside], own)

        def way(baseline: Segments | None) -> Learned:
            data = rows_to_learn(library, fits, segments[torch.cat(rests)], group, baseline)
            return learned(problem.simulation, data, len(fits), held_out, self._sensor[aside])

        best = way(None)
        if self.plenty.baseline is not None:
            both = way(self.plenty.baseline)
            if both.distance < best.distance:
                best = replace(both, recipe=replace(both.recipe, baseline=True))
        return HeldOutResiduals(best.models, best.recipe)

    def rest(self, aside: Tensor) -> Tensor:
        """Rows that are not set aside; of a single block, which proves nothing, all."""
        return _rest(self.problem.segments, aside)

    def errors(self, stacks: Mapping[str, "Stack"], seconds: float = math.inf) -> dict[str, Errors]:
        """Errors of rollouts of what is held out.

        Args:
            stacks: Name -> hypotheses of the folds, and maybe residuals.
            seconds: That a rollout is expected to take.
        """
        library, simulation = self.problem.library, self.problem.simulation
        plain = [name for name, stack in stacks.items() if stack.residuals is None]
        upon = [name for name in stacks if name not in plain]
        tasks: list[tuple[Any, ...]] = []
        for part, owner in self.parts:
            rows = {
                name: (stack.fits[0], torch.stack([f.vector for f in stack.fits])[owner])
                for name, stack in stacks.items()
            }
            if plain:
                tasks.append((part, library.settings([rows[name] for name in plain]), ()))
            for name in upon:
                residuals = stacks[name].residuals
                assert residuals is not None
                settings = library.settings([rows[name]])
                tasks.append((part, settings, (residuals.effect(owner, part.dt),)))
        rolled = iter(simulation.apart(_residuals, tasks, seconds))
        result = {name: Errors() for name in stacks}
        for number, (part, _) in enumerate(self.parts):
            instants = simulation.instants(part)
            found = [*next(rolled)] if plain else []
            found += [residual for _ in upon for residual in next(rolled)]
            for name, residual in zip((*plain, *upon), found, strict=True):
                away = residual[..., :2].square().sum(-1)
                result[name].add(away, instants, part.dt)
                if number == 0:  # what is fitted to
                    within = instants <= round(SAID / part.dt)
                    result[name].distance = away[:, within].mean(1).sqrt()
                    result[name].square = self._square(residual, self.problem.noise)
                    result[name].sensed = (
                        result[name].square
                        if self._sensor is self.problem.noise
                        else self._square(residual, self._sensor)
                    )
        return result

    def floor(self, fit: Hypothesis) -> Errors:
        """Errors that a simulator without fault has: of its sensor, and of where rollouts start.

        Args:
            fit: Hypothesis by which errors of a start grow.
        """
        settings = self.problem.library.settings([(fit, fit.vector)])
        errors, seen = Errors(), self.problem.segments
        for part, _ in self.parts:
            add_without_fault(errors, self.problem.simulation, part, settings, seen)
        return errors

    @staticmethod
    def _square(residual: Tensor, noise: NoiseModel) -> Tensor:
        """|W e|^2 / D [N] of residuals [N, K, 6]."""
        return noise.whiten(residual.unsqueeze(0))[0].square().mean(-1)


def add_without_fault(
    errors: Errors,
    simulation: Simulation,
    segments: Segments,
    settings: ParameterSets,
    noise_from: Segments | None = None,
) -> None:
    """Counts the errors of a simulator without fault, by `drawn_errors` of the same arguments."""
    drawn = drawn_errors(simulation, segments, settings, noise_from)
    errors.add(drawn[..., :2].square().sum(-1), simulation.instants(segments), segments.dt)


@dataclass(frozen=True, eq=False)
class Stack:
    """What is validated: a hypothesis for each fold, and maybe a learned residual upon it."""

    fits: Sequence[Hypothesis]
    residuals: HeldOutResiduals | None = None


def validated(
    validation: Validation, best: Hypothesis, others: Mapping[str, Hypothesis] | None = None
) -> tuple[dict[str, Stack], dict[str, Errors]]:
    """What a repair is compared with, and their errors on what nothing was fitted to.

    Args:
        validation: Of the problem that `best` was fitted to.
        best: The hypothesis; fitted anew for each fold that is held out, its clock left out.
        others: Name -> further hypotheses, treated like `best`.

    Returns:
        `before`: as given. `after`: with the effects. `retuned`: with the simulator's own
        parameters fitted instead, or `TRIMS` where it declares none. `black_box`: with a
        learned residual instead. Besides, those of `others`.
    """
    problem = validation.problem
    starts = {"after": best, **(others or {})}
    own = retunable(problem.library)
    if own:
        starts["retuned"] = problem.library.at(own, best.named())
    begun = time.perf_counter()
    residuals = validation.residuals()
    seconds = time.perf_counter() - begun
    nothing = [problem.library.hypothesis(()).as_stamped] * len(validation.aside)
    stacks = {"before": Stack(nothing)}
    refits = validation.refitted(starts, seconds)
    stacks |= {name: Stack(fits) for name, fits in refits.items()}
    stacks["black_box"] = Stack(nothing, residuals)
    return stacks, validation.errors(stacks, seconds)


def rows_to_learn(
    library: Library,
    fits: Sequence[Hypothesis],
    segments: Segments,
    group: Tensor,
    baseline: Segments | None = None,
) -> Rows:
    """Segments that residuals learn from, with what each one's group has in place.

    On a baseline the simulator was right: what is named was not there, nor was a parameter of the
    simulator another.

    Args:
        library: Of the hypotheses.
        fits: Hypothesis of each group.
        segments: N of them.
        group: Group [N] of each.
        baseline: Segments of the car as it was, from which every group learns too.
    """
    vectors = torch.stack([fit.vector for fit in fits])[group]
    if baseline is not None:
        more, count = len(fits) * len(baseline), len(fits)
        segments = segments_joined([segments, *[baseline] * count])
        group = torch.cat([group, torch.arange(count).repeat_interleave(len(baseline))])
        vectors = torch.cat([vectors, vectors.new_zeros(more, vectors.shape[1])])
    return Rows(segments, group, library.settings([(fits[0], vectors)]))


@dataclass(frozen=True, eq=False)
class Delivered:
    """What a simulator's file holds, and how far its rollouts are."""

    fit: Hypothesis
    residual: Residual | None
    """What is learned in it, on a baseline too."""
    errors: Errors
    """Errors over all that it was fitted to: those of the file itself."""


def delivered(
    problem: Problem,
    best: Hypothesis,
    iterations: int = FULL.iterations,
    recipe: Recipe | None = None,
    plenty: Plenty | None = None,
) -> Delivered:
    """A hypothesis as a simulator's file can hold it, fitted to all segments.

    Args:
        problem: Segments that it is fitted to, all of them.
        best: Where the fit begins; its clock is left out.
        iterations: Of the fit.
        recipe: Of a residual that is learned upon it; None for none.
        plenty: As of a `Validation`.
    """
    [fit] = _fitted(problem, [best.as_stamped], iterations)
    simulation, residual = problem.simulation, None
    segments, settings = problem.segments, problem.library.settings([(fit, fit.vector)])
    if recipe is not None:
        plenty = plenty or Plenty(segments)
        group = torch.zeros(len(plenty.segments), dtype=torch.long)
        beside = plenty.baseline if recipe.baseline else None
        rows = rows_to_learn(problem.library, [fit], plenty.segments, group, beside)
        residual = _upon_standing(simulation, relearned(simulation, rows, recipe))
        effect = ResidualAcceleration(model=residual, strength=1.0, dt=segments.dt)
        simulation = replace(simulation, standing=(effect,))
    [found] = simulation.residuals(segments, settings)
    errors, instants = Errors(), simulation.instants(segments)
    errors.add(found[..., :2].square().sum(-1), instants, segments.dt)
    return Delivered(fit, residual, errors)


def _upon_standing(simulation: Simulation, model: ResidualProcess) -> Residual:
    """A model upon those that stand in a simulation, as one."""
    parts = [
        (float(e.values["strength"]), e.network)
        for e in simulation.standing
        if isinstance(e, ResidualAcceleration) and not isinstance(e.network, ResidualSum)
    ]
    return ResidualSum([*parts, (1.0, model)]) if parts else model


def _residuals(
    simulation: Simulation, part: Segments, settings: ParameterSets, standing: Sequence[Effect]
) -> Tensor:
    """HeldOutResiduals [C, N, K, 6], with further effects."""
    beside = (*simulation.standing, *standing)
    return replace(simulation, standing=beside).residuals(part, settings)


def segment_folds(segments: Segments) -> Tensor:
    """Fold [N] of each segment: whole recordings where there are several, else blocks in turn."""
    recordings = segments.recording.unique()
    if len(recordings) >= FOLDS:
        rank = {int(r): i % FOLDS for i, r in enumerate(recordings)}
        return torch.tensor([rank[int(r)] for r in segments.recording])
    return blocks(segments) % FOLDS


def retunable(library: Library) -> tuple[str, ...]:
    own = tuple(OWN + name for name in library.parameters if library.own)
    return own or tuple(n for n in TRIMS if n in library.effects and effect_class(n).declared)


def _begun(start: Hypothesis) -> Hypothesis:
    """Start of a fold's fit: the simulator's own parameters as they are given."""
    own = torch.tensor([c.effect.startswith(OWN) for c in start.coordinates], dtype=torch.bool)
    return replace(start, vector=torch.where(own, torch.zeros_like(start.vector), start.vector))


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


def _rest(segments: Segments, aside: Tensor) -> Tensor:
    """Rows that are not set aside; of a single block, which proves nothing, all."""
    kept = torch.ones(len(segments), dtype=torch.bool)
    kept[aside] = False
    return torch.nonzero(kept if bool(kept.any()) else ~kept).flatten()


def _owned(part: Segments, segments: Segments, fold: Tensor) -> tuple[Segments, Tensor]:
    """Other segments of the same recordings, without those whose block has none; their folds."""
    by_block = dict(zip(_blocks(segments), fold.tolist(), strict=True))
    owner = torch.tensor([by_block.get(block, -1) for block in _blocks(part)])
    return part[owner >= 0], owner[owner >= 0]


def _blocks(segments: Segments) -> list[tuple[int, int]]:
    block = (segments.row.double() * segments.dt / BLOCK).long()
    return list(zip(segments.recording.tolist(), block.tolist(), strict=True))
