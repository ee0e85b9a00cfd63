"""Recordings and a simulator, ready to be compared: cut drives, criteria of a search, the case."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import Similarity, VehicleDimensions
from buggy_rl.diagnosis.config import DEFAULTS, DiagnosisConfig, SearchConfig
from buggy_rl.diagnosis.preflight.simulator import FASTEST
from buggy_rl.diagnosis.run.budget import FULL, Budget
from buggy_rl.estimation.baseline import Correction
from buggy_rl.estimation.body import body_of, bounded_by
from buggy_rl.estimation.evidence import (
    BLOCK,
    NO_BASELINE,
    BaselineMisfit,
    baseline_misfit,
    blocks,
)
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import OWN, Hypothesis, Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import HORIZONS, WARM_UP, Segments, cut_segments
from buggy_rl.recordings import Recording

PLENTY = 2
MOST_BAD = 0.5  # share of segments that may be no numbers


@dataclass(frozen=True, eq=False)
class Plenty:
    """Segments to learn from: a learned residual has more weights than anything else numbers."""

    segments: Segments
    """Segments of the recordings, up to `PLENTY` times as many as are searched."""
    baseline: Segments | None = None
    """Segments of the baseline, likewise, where there is one."""


@dataclass(frozen=True, eq=False)
class Drives:
    """What a simulator should have predicted, and what it predicts rightly."""

    recordings: Sequence[Recording]
    segments: Segments
    """Segments of the recordings, as many as are asked for, spread evenly."""
    longer: Mapping[float, Segments] = field(default_factory=dict)
    """Horizon [s] beyond that of `segments` -> all segments of that length."""
    baseline: Segments | None = None
    """Segments of recordings on which the simulator counts as right, likewise spread; None without
    any."""
    plenty: Plenty | None = None
    """Segments that a residual learns from; None for those above."""

    @classmethod
    def cut(
        cls,
        config: DiagnosisConfig,
        recordings: Sequence[Recording],
        baseline: Sequence[Recording] = (),
    ) -> "Drives":
        """Cuts recordings as a question asks for it.

        Raises:
            ValueError: They have no gap-free segment of that length.
        """
        return cls(
            recordings,
            segments_of(recordings, config),
            longer_segments(recordings, config.seconds),
            segments_of(baseline, config) if baseline else None,
            Plenty(
                segments_of(recordings, config, PLENTY),
                segments_of(baseline, config, PLENTY) if baseline else None,
            ),
        )

    def within(self, budget: Budget) -> "Drives":
        """The drives with as many segments as a budget has."""

        def few(segments: Segments) -> Segments:
            return segments.spread(budget.segments(len(segments)))

        before, plenty = self.baseline, self.plenty
        if plenty is not None:
            beside = None if plenty.baseline is None else few(plenty.baseline)
            plenty = Plenty(few(plenty.segments), beside)
        return replace(
            self,
            segments=few(self.segments),
            baseline=None if before is None else few(before),
            plenty=plenty,
        )


def segments_of(
    recordings: Sequence[Recording], config: DiagnosisConfig, times: int = 1
) -> Segments:
    """Cuts so many times as many segments as are asked for, spread evenly over recordings."""
    every = cut_segments(recordings, config.seconds, config.seconds)
    return every.spread(times * config.stretches)


def longer_segments(recordings: Sequence[Recording], seconds: float) -> dict[float, Segments]:
    """Horizon [s] beyond `seconds` -> segments; none where no gap-free part is that long."""
    found = {}
    for horizon in HORIZONS:
        if horizon > seconds:
            try:
                found[horizon] = cut_segments(recordings, horizon, horizon)
            except ValueError:
                continue
    return found


@dataclass(frozen=True, eq=False)
class Criteria:
    """Blocks, baseline and numerical settings of a search."""

    group: Tensor
    """[N] blocks of segments that are held out together."""
    usual: BaselineMisfit = NO_BASELINE
    baseline: Problem | None = None
    """Problem on segments on which the simulator counts as right."""
    rules: SearchConfig = DEFAULTS
    anew: bool = True
    """Whether what is held out is rolled out anew; predicted to first order otherwise."""


@dataclass(frozen=True, eq=False)
class Retuned:
    """The simulator's own parameters, fitted to the recordings all at once."""

    fit: Hypothesis
    """All parameters that the simulator declares; the clock's coordinate is the last."""
    covariance: Tensor
    """[P, P] of the coordinates, by leaving out blocks."""

    @property
    def values(self) -> dict[str, float]:
        """Parameter -> value in its unit."""
        own = self.fit.values()
        return {n: v for effect, numbers in own.items() if effect for n, v in numbers.items()}


@dataclass(frozen=True, eq=False)
class DiagnosisCase:
    """What a diagnosis computes with."""

    problem: Problem
    criteria: Criteria
    drives: Drives
    retuned_from: Simulation | None = None
    """Simulation of the simulator as it was given, where it has been re-tuned since."""
    budget: Budget = FULL
    """How much the search may roll out."""
    correction: Correction | None = None
    """Correction of what the simulator got wrong on its baseline, where one was given."""
    tuned: Retuned | None = None
    """The simulator's own parameters, where it has been re-tuned."""
    similarity: Similarity = field(default_factory=Similarity)
    """Ratios of the car to the buggy, by the question's `car`."""
    apart: Tensor | None = None
    """[N, D, D] covariance of what recordings do not share, where they were found to differ."""

    def with_apart(self, apart: Tensor) -> "DiagnosisCase":
        """The case with the covariance of what recordings do not share in its noise model."""
        problem, standing = self.problem, self.problem.noise.extra
        extra = apart if standing is None else apart + standing
        noise = noise_model(problem.simulation, problem.segments, extra=extra)
        return replace(self, problem=replace(problem, noise=noise), apart=apart)

    @property
    def recordings(self) -> Sequence[Recording]:
        """What the simulator should have predicted."""
        return self.drives.recordings

    @property
    def one_block(self) -> bool:
        """Whether all that was driven lies within one block: then nothing can be held out."""
        return bool(check_blocks(self.criteria.group))

    @property
    def names(self) -> list[str]:
        """Names of the recordings."""
        return [recording.name for recording in self.recordings]

    @property
    def command(self) -> LongitudinalCommand:
        """What the recordings' throttle is."""
        return self.recordings[0].command

    @property
    def given(self) -> Simulation:
        """Simulation of the simulator as it was given."""
        return self.retuned_from or self.problem.simulation

    @property
    def as_given(self) -> Library:
        """The library, with what the simulator as given has of each parameter."""
        if self.retuned_from is None:
            return self.problem.library
        given = self.retuned_from.make(1)
        declared: dict[str, Parameter] = getattr(given, "declared", {})
        declared = {name: bounded_by(body_of(given), p) for name, p in declared.items()}
        library = self.problem.library
        return Library(library.effects, declared, similarity=library.similarity)

    def about_given(self, hypothesis: Hypothesis) -> Hypothesis:
        """A hypothesis about the case's simulator, as one about the simulator as it was given.

        Where that one was re-tuned since, the re-tuned parameters become effects of the hypothesis.
        """
        if self.retuned_from is None:
            return hypothesis
        library = self.problem.library
        own = [OWN + name for name in library.parameters]
        start = self.as_given.hypothesis((*hypothesis.effects, *own))
        tuned = {p.name: p.value for p in library.parameters.values()}
        moved = [
            float(c.parameter.coordinate(tuned[c.parameter.name]))
            for c in start.coordinates
            if c.effect in own
        ]
        z = hypothesis.vector
        return replace(start, vector=torch.cat([z[:-1], z.new_tensor(moved), z[-1:]]))

    def car_of(self, effect: str) -> VehicleDimensions:
        """Dimensions that an effect has been told of; where it has not, the buggy's."""
        own = self.problem.simulation.options.get(effect, {})
        return VehicleDimensions(**own.get("dimensions", {}))


def prepare_case(
    simulation: Simulation,
    drives: Drives,
    library: Library,
    config: DiagnosisConfig,
    correction: Correction | None = None,
    budget: Budget = FULL,
    apart: Tensor | None = None,
) -> DiagnosisCase:
    """Linearises the noise model of drives about a simulator.

    Args:
        simulation: Of the simulator.
        drives: What it should have predicted, within the budget.
        library: Effects to choose from.
        config: Thresholds, and the car.
        correction: Of what the simulator gets wrong on the drives' baseline.
        budget: How much the search may roll out.
        apart: [N, D, D] covariance of what recordings do not share.
    """
    extra = apart
    if correction is not None:
        simulation = correction.simulation(simulation)
        extra = correction.covariance if apart is None else correction.covariance + apart
    noise = noise_model(simulation, drives.segments, extra=extra)
    problem = Problem(simulation, drives.segments, noise, library)
    criteria = Criteria(blocks(drives.segments), rules=config.search)
    if correction is not None and drives.baseline is not None:
        others = len(criteria.group.unique())
        criteria = replace(
            criteria,
            usual=baseline_misfit(correction.held_out, blocks(drives.baseline), others),
            baseline=Problem(simulation, drives.baseline, correction.noise, library),
        )
    similarity = load_car(config.car).similarity if config.car else Similarity()
    return DiagnosisCase(
        problem,
        criteria,
        drives,
        budget=budget,
        correction=correction,
        similarity=similarity,
        apart=apart,
    )


def check_case(case: DiagnosisCase, name: str) -> list[str]:
    """Notes on rollouts of the simulator as given, and on what can be held out.

    Args:
        case: Nothing of it has been searched: its noise model is about the simulator as given.
        name: What the user calls the simulator.

    Raises:
        ValueError: As `check_residuals`.
    """
    problem, residuals = case.problem, case.problem.noise.about
    assert residuals is not None
    instants = problem.simulation.instants(problem.segments)
    notes = check_residuals(residuals, problem.segments, instants, case.names, name)
    return [*notes, *check_blocks(case.criteria.group)]


def check_blocks(group: Tensor) -> list[str]:
    """Whether blocks [N] of segments can be held out by turns at all."""
    if len(group.unique()) > 1:
        return []
    return [
        f"all that was driven lies within one block of {BLOCK:g} s: nothing can be held out, so "
        "nothing can be named; drive for a minute"
    ]


def check_residuals(
    residuals: Tensor, segments: Segments, instants: Tensor, drives: Sequence[str], name: str
) -> list[str]:
    """Whether rollouts of a simulator are numbers that a car could show.

    Args:
        residuals: [N, K, 6] readings minus measurements.
        segments: N segments.
        instants: [K] rows after their start.
        drives: Their names.
        name: What the user calls the simulator.

    Raises:
        ValueError: More than half of the segments are none.
    """
    wrong = ~(residuals.abs() < FASTEST).all(-1)  # (N, K); NaN is not below anything either
    segment = wrong.any(1)
    if not bool(segment.any()):
        return []
    first = int(segment.int().argmax())
    row = int(wrong[first].int().argmax())
    time = float(segments.elapsed[first]) + WARM_UP + int(instants[row]) * segments.dt
    what = "runs away" if bool(residuals[first, row].isfinite().all()) else "returns NaN"
    message = (
        f"simulator {name} {what} in {int(segment.sum())} of {len(residuals)} segments, first in "
        f"drive {drives[int(segments.recording[first])]} at {time:.2f} s"
    )
    if float(segment.double().mean()) > MOST_BAD:
        raise ValueError(
            f"{message}; play the commands of that second into it from the pose and velocity "
            "measured there, and mend it"
        )
    return [f"{message}; those count as very wrong"]
