"""Recordings and a simulator, ready to be compared."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.run.budget import FULL, Budget
from buggy_rl.diagnosis.run.criteria import Criteria
from buggy_rl.diagnosis.run.drives import Drives
from buggy_rl.estimation.baseline import Correction
from buggy_rl.estimation.body import body_of, bounded_by
from buggy_rl.estimation.evidence import baseline_misfit, blocks
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.recordings import Recording

if TYPE_CHECKING:
    from buggy_rl.diagnosis.answer.retuning import Retuned


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
    tuned: "Retuned | None" = None
    """The simulator's own parameters, where it has been re-tuned."""

    @property
    def recordings(self) -> Sequence[Recording]:
        """What the simulator should have predicted."""
        return self.drives.recordings

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
) -> DiagnosisCase:
    """Linearises the noise model of drives about a simulator.

    Args:
        simulation: Of the simulator.
        drives: What it should have predicted, within the budget.
        library: Effects to choose from.
        config: Thresholds.
        correction: Of what the simulator gets wrong on the drives' baseline.
        budget: How much the search may roll out.
    """
    extra = None
    if correction is not None:
        simulation, extra = correction.simulation(simulation), correction.covariance
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
    return DiagnosisCase(problem, criteria, drives, budget=budget, correction=correction)
