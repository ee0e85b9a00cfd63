"""Leads from recordings and a simulator to the answer, stage by stage."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from buggy_rl.core.car_file import load_car
from buggy_rl.diagnosis.answer.answer import Answer
from buggy_rl.diagnosis.answer.experiments import decided
from buggy_rl.diagnosis.answer.other_sensors import other_sensors
from buggy_rl.diagnosis.answer.retuning import retuned
from buggy_rl.diagnosis.answer.sections import answered
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.preflight.commands import CommandCheck, check_commands
from buggy_rl.diagnosis.preflight.integration import IntegrationStep, fine_enough
from buggy_rl.diagnosis.preflight.recordings import (
    check_blocks,
    check_clock,
    check_drives,
    check_latency,
    check_residuals,
    weak,
)
from buggy_rl.diagnosis.preflight.simulator import blaming, check_simulator
from buggy_rl.diagnosis.repair.proof import Proof
from buggy_rl.diagnosis.run.case import DiagnosisCase, prepare_case
from buggy_rl.diagnosis.run.drives import Drives
from buggy_rl.diagnosis.run.maker import Maker, engine_of, own_options
from buggy_rl.diagnosis.run.meter import Meter, MeterReading
from buggy_rl.diagnosis.run.opening import measured, measured_again
from buggy_rl.diagnosis.run.plan import plan_of
from buggy_rl.diagnosis.run.stages import Stages
from buggy_rl.diagnosis.search.candidate import Effects
from buggy_rl.diagnosis.search.joint import Keep, joint_search
from buggy_rl.diagnosis.search.limits import same_sets
from buggy_rl.diagnosis.search.observed import concluded
from buggy_rl.diagnosis.search.posterior import Posterior
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.baseline import Correction, correct
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.workers import Workers
from buggy_rl.recordings import Recording
from buggy_rl.recordings.recording import refuse_another_rest
from buggy_rl.simulators import ENGINES, simulator_name
from buggy_rl.task.augment import effects_of

Progress = Callable[[str], None]
SHORT = (
    "the search was as short as it can be, since the commands do not predict the motion: minutes=0 "
    "searches in full all the same"
)


@dataclass(frozen=True, eq=False)
class Diagnosed:
    """The answer, and what it came from."""

    case: DiagnosisCase
    found: SearchResult
    answer: Answer
    step: dict[str, Any] = field(default_factory=dict)
    """Options of the simulator with which it integrates finely enough, where it did not."""

    @property
    def correction(self) -> Correction | None:
        """Correction of what the simulator got wrong before anything changed, given a baseline."""
        return self.case.correction

    @property
    def tuned(self) -> dict[str, float] | None:
        """The simulator's own parameters, where it was re-tuned first."""
        return None if self.case.tuned is None else self.case.tuned.values


def run_diagnosis(
    config: DiagnosisConfig,
    recordings: Sequence[Recording],
    progress: Progress = lambda _: None,
    baseline: Sequence[Recording] = (),
    kept: Path | None = None,
    show: Callable[[MeterReading], None] = lambda _: None,
) -> Diagnosed:
    """Compares a simulator with recordings.

    With baseline recordings, on which it counts as right, its standing errors are closed on them
    first, and what is found is what has changed since.

    Args:
        config: The question.
        recordings: What the simulator should have predicted.
        progress: Told what is being done.
        baseline: Recordings on which it was right.
        kept: Folder in which stages are kept, so that an interrupted diagnosis goes on from them.
        show: Told after every rollout how far it is and how long it will take.

    Raises:
        ValueError: The recordings cannot be used, or the simulator breaks its contract; the
            message says which and what to do.
    """
    begun = time.perf_counter()
    name, count = simulator_name(config.simulator), config.workers
    if callable(config.simulator):  # no other process finds it, and no file tells what it does
        kept, count = None, 1
    stages, meter = Stages(kept, config, recordings, baseline), Meter(show, progress)
    progress("looking at drives and simulator")
    seen = _preflight(config, recordings, baseline)
    drives = Drives.cut(config, recordings, baseline)
    with blaming(name), Workers(count) as workers:
        step = _step(config, drives)
        make = Maker.of(config, options=step.options)
        simulation = Simulation(make, workers=workers, rolled=meter.rolled)
        spent = time.perf_counter() - begun  # a chain of its measurement has about as many steps
        ready = measured(config, simulation, drives, spent)
        simulation, library = ready.simulation, ready.library
        plan = stages.done(
            "plan",
            lambda: plan_of(
                simulation, library, drives, config.minutes, begun, SHORT if seen.first else ""
            ),
        )
        meter.begin(plan, deadline=begun + (60 * config.minutes or math.inf))
        drives = drives.within(plan.budget)
        correction = _corrected(simulation, drives, stages, progress)
        case = prepare_case(simulation, drives, library, config, correction, plan.budget)
        left = _checked(case, name)
        done = _diagnosed(case, stages, "", meter)
        done = replace(done, step={**own_options(config), **step.options})
        again = left_open(done.found.posterior, done.found.best.effects, done.answer.proof)
        again = again and not (seen.first and config.minutes)
        left_out: list[str] = []
        if library.parameters and not baseline and again:
            if meter.admits("retuning"):
                done = _retuned_first(config, done, stages, meter)
            else:
                left_out = ["re-tuning the simulator's own parameters"]
    short = check_blocks(case.problem.segments)
    left_out = [*done.answer.left_out, *left_out]
    offset = done.found.best.fit.values()[""]["clock_offset"]
    notes = [
        *(*seen.notes, *ready.notes, *plan.notes),
        *([correction.note] if correction else []),
        *(*left, *short),
        *([step.note] if step.note else []),
        *(f"left out: {part}; minutes={config.minutes:g} were up" for part in left_out),
        *(*check_clock(offset), *check_latency(done.found.best.effects, offset)),
    ]
    answer = replace(
        done.answer,
        notes=notes,
        verdict="cannot_tell" if short or seen.first else done.answer.verdict,
        sensors=other_sensors(recordings),
        first=seen.first,
    )
    if config.car:
        similarity = load_car(config.car).similarity
        answer = replace(answer, weak=weak(done.case.problem.segments, similarity))
    return replace(done, answer=answer)


def open_case(
    config: DiagnosisConfig,
    recordings: Sequence[Recording],
    baseline: Sequence[Recording] = (),
) -> DiagnosisCase:
    """Recordings and simulator, ready to be searched; arguments as of `run_diagnosis`."""
    drives = Drives.cut(config, recordings, baseline)
    make = Maker.of(config, options=_step(config, drives).options)
    ready = measured(config, Simulation(make), drives)
    correction = _corrected(ready.simulation, drives, Stages(None, config), lambda _: None)
    return prepare_case(ready.simulation, drives, ready.library, config, correction)


def _preflight(
    config: DiagnosisConfig, recordings: Sequence[Recording], baseline: Sequence[Recording]
) -> CommandCheck:
    """Notes on drives and simulator, and what the answer begins with."""
    notes, first = list[str](), list[str]()
    for drives in (recordings, baseline) if baseline else (recordings,):
        notes += check_drives(drives, config.seconds, config.dt)
        commands = check_commands(drives)
        notes, first = [*notes, *commands.notes], [*first, *commands.first]
    make = Maker.of(config)
    notes += check_simulator(make, simulator_name(config.simulator), config.dt)
    refuse_another_rest([*recordings, *baseline], make(1))
    inside = [effect.name for effect in effects_of(make(1))]
    if inside:
        notes.append(f"the simulator has {', '.join(inside)} already: not looked for again")
    return CommandCheck(first, notes)


def _step(config: DiagnosisConfig, drives: Drives) -> IntegrationStep:
    """Integration step for these drives; a user's own factory takes no options."""
    if engine_of(config.simulator) not in ENGINES:
        return IntegrationStep()
    return fine_enough(
        lambda options: Simulation(Maker.of(config, options=options)),
        drives.segments,
        config.search.finer_step_gain,
    )


def _corrected(
    simulation: Simulation, drives: Drives, stages: Stages, progress: Progress
) -> Correction | None:
    """The correction of what the simulator gets wrong on the baseline, where there is one."""
    before = drives.baseline
    if before is None:
        return None
    return stages.done("correction", lambda: correct(simulation, before, 0, progress))


def _checked(case: DiagnosisCase, name: str) -> list[str]:
    problem, residuals = case.problem, case.problem.noise.about
    assert residuals is not None  # nothing has been searched: they are of the simulator as given
    instants = problem.simulation.instants(problem.segments)
    return check_residuals(residuals, problem.segments, instants, case.names, name)


def _searched(case: DiagnosisCase, meter: Meter, kept: Keep) -> SearchResult:
    found = joint_search(
        case.problem,
        case.criteria,
        progress=meter.says,
        budget=case.budget,
        kept=kept,
        admits=meter.admits,
    )
    tried = {w.candidate.key: w.candidate for w in found.weighed}
    return concluded(case.criteria, found, same_sets(tried, found.problem.segments))


def _diagnosed(case: DiagnosisCase, stages: Stages, stage: str, meter: Meter) -> Diagnosed:
    """Searches and answers, or takes what was kept under the stage's name."""
    meter.stage("search")

    def kept(name: str, compute: Callable[[], Any]) -> Any:
        return stages.done(f"{stage}{name}", compute)

    found = kept("search", lambda: _searched(case, meter, kept))
    case = replace(case, problem=found.problem(case.problem))
    meter.stage("answer")
    said = kept("answer", lambda: answered(case, found, meter.says, meter.admits))
    return Diagnosed(case, found, said)


def left_open(posterior: Posterior, named: Effects, proof: Proof) -> bool:
    """Whether parameters of the simulator may be off: it is re-tuned then, and searched again."""
    unsure = not decided(posterior, named) and proof.prefers_retuning
    return posterior.says == "unknown" or unsure


def _retuned_first(
    config: DiagnosisConfig, done: Diagnosed, stages: Stages, meter: Meter
) -> Diagnosed:
    """Looks again with all parameters of the simulator fitted; the better answer of both.

    A few effects explain a simulator that is right but for them. One that was never fitted to this
    car is wrong in everything a little, and missing physics shows only after that.
    """
    given = done.case.problem.simulation
    first = replace(done.case, problem=replace(done.case.problem, dispersion=1.0))
    tuned = stages.done("retuning", lambda: retuned(first, meter.says))
    make = Maker.of(config, tuned.values, done.step)
    ready = measured_again(config, given, make, done.case.problem.library)
    drives, budget = done.case.drives, done.case.budget
    case = prepare_case(ready.simulation, drives, ready.library, config, budget=budget)
    again = _diagnosed(replace(case, retuned_from=given, tuned=tuned), stages, "second_", meter)
    if not again.answer.proof.better_than(done.answer.proof):
        return done
    return replace(again, step=done.step)
