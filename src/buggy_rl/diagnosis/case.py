"""Recordings and a simulator, ready to be compared."""

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from buggy_rl.diagnosis.budget import FULL, Budget
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.criteria import Criteria
from buggy_rl.estimation.body import body_of, bounded_by
from buggy_rl.estimation.cross_validation import blocks
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments, cut_segments
from buggy_rl.parameters import Parameter
from buggy_rl.recordings import Recording


@dataclass(frozen=True, eq=False)
class Case:
    """What a diagnosis computes with."""

    problem: Problem
    criteria: Criteria
    recordings: Sequence[Recording]
    retuned_from: Simulation | None = None
    """Of the simulator as it was given, where it has been re-tuned since."""
    budget: Budget = FULL
    """How much the search may roll out."""

    @property
    def names(self) -> list[str]:
        """Of the recordings."""
        return [recording.name for recording in self.recordings]

    @property
    def given(self) -> Simulation:
        """Of the simulator as it was given."""
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


def prepared(
    simulation: Simulation,
    recordings: Sequence[Recording],
    library: Library,
    config: DiagnosisConfig,
    extra: Tensor | None = None,
    budget: Budget = FULL,
) -> Case:
    """Cuts recordings and linearises their noise model.

    Args:
        simulation: Of the simulator.
        recordings: What it should have predicted.
        library: Effects to choose from.
        config: Length and number of the segments, and thresholds.
        extra: [D, D] covariance of what the simulator gets wrong on its baseline.
        budget: How much the search may roll out.
    """
    segments = segments_of(recordings, config, budget)
    noise = noise_model(simulation, segments, extra=extra)
    problem = Problem(simulation, segments, noise, library)
    criteria = Criteria(blocks(segments), rules=config.search)
    return Case(problem, criteria, recordings, budget=budget)


def segments_of(
    recordings: Sequence[Recording], config: DiagnosisConfig, budget: Budget = FULL
) -> Segments:
    """As many segments as are asked for and the budget has, spread evenly."""
    segments = cut_segments(recordings, config.seconds, config.seconds).spread(config.stretches)
    return segments.spread(budget.segments(len(segments)))
