"""From recordings and a simulator to the answer, stage by stage."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from buggy_rl.car_file import load_car
from buggy_rl.diagnosis.answer import Answer
from buggy_rl.diagnosis.budget import FULL, Budget
from buggy_rl.diagnosis.candidate import Effects
from buggy_rl.diagnosis.case import Case, prepared, segments_of
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.excitation import weak
from buggy_rl.diagnosis.experiments import decided
from buggy_rl.diagnosis.integration import Step, fine_enough
from buggy_rl.diagnosis.joint import Keep, joint_search
from buggy_rl.diagnosis.limits import same_sets
from buggy_rl.diagnosis.maker import Maker
from buggy_rl.diagnosis.meter import Meter, Reading
from buggy_rl.diagnosis.observed import concluded
from buggy_rl.diagnosis.other_sensors import other_sensors
from buggy_rl.diagnosis.planning import plan_of
from buggy_rl.diagnosis.posterior import Posterior
from buggy_rl.diagnosis.preflight_commands import check_commands
from buggy_rl.diagnosis.preflight_recordings import (
    check_blocks,
    check_clock,
    check_drives,
    check_latency,
    check_residuals,
)
from buggy_rl.diagnosis.preflight_simulator import blaming, check_simulator
from buggy_rl.diagnosis.proof import Proof
from buggy_rl.diagnosis.retuning import Retuned, retuned
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.diagnosis.stages import Stages
from buggy_rl.diagnosis.statement import answered
from buggy_rl.effects import OF_A_COLUMN, offered
from buggy_rl.effects.measuring import in_turn, measurable_options
from buggy_rl.engines import ENGINES, Factory, read_simulator, simulator_name
from buggy_rl.estimation.baseline import Correction, correct
from buggy_rl.estimation.body import body_of, bounded_by
from buggy_rl.estimation.cross_validation import blocks
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.misfit import baseline_misfit
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.workers import Workers
from buggy_rl.longitudinal import declared_by
from buggy_rl.recordings import Recording
from buggy_rl.recordings.recording import refuse_another_rest
from buggy_rl.similarity import Similarity
from buggy_rl.task.augment import effects_of
from buggy_rl.vehicle import CONTROL_PERIOD, VehicleDimensions

Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The answer, and what it came from."""

    case: Case
    found: SearchResult
    answer: Answer
    correction: Correction | None = None
    """Of what the simulator got wrong before anything changed, where a baseline was given."""
    tuned: dict[str, float] | None = None
    """The simulator's own parameters, where it was re-tuned first."""
    step: dict[str, Any] = field(default_factory=dict)
    """Options of the simulator with which it integrates finely enough, where it did not."""


def diagnose(
    config: DiagnosisConfig,
    recordings: Sequence[Recording],
    progress: Progress = lambda _: None,
    baseline: Sequence[Recording] = (),
    kept: Path | None = None,
    show: Callable[[Reading], None] = lambda _: None,
) -> Diagnosis:
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
    notes, first = _preflight(config, recordings, baseline)
    with blaming(name), Workers(count) as workers:
        step = _step(config, recordings)
        simulation = Simulation(
            maker(config, options=step.options), workers=workers, rolled=meter.rolled
        )
        spent = time.perf_counter() - begun  # a chain of its measurement has about as many steps
        simulation, library, more = _measured(
            config, simulation, recordings, own=not baseline, seconds=spent
        )
        plan = stages.done(
            "plan", lambda: plan_of(config, simulation, library, recordings, baseline, begun)
        )
        meter.begin(plan)
        case, correction = _case(
            config, simulation, library, (recordings, baseline), stages, progress, plan.budget
        )
        notes += [*more, *plan.notes, *([correction.note] if correction else [])]
        short = check_blocks(case.problem.segments)
        notes += _checked(case, name)
        done = _diagnosed(config, case, stages, "", meter)
        done = replace(done, correction=correction, step={**_own(config), **step.options})
        again = left_open(done.found.posterior, done.found.best.effects, done.answer.proof)
        if case.problem.library.parameters and not baseline and again:
            done = _retuned_first(config, done, stages, meter)
    offset = done.found.best.fit.values()[""]["clock_offset"]
    notes += short + ([step.note] if step.note else []) + check_clock(offset)
    notes += check_latency(done.found.best.effects, offset)
    verdict = "cannot_tell" if short or first else done.answer.verdict
    if config.car:
        driven = weak(done.case.problem.segments, load_car(config.car).similarity)
        done = replace(done, answer=replace(done.answer, weak=driven))
    measured = other_sensors(recordings)
    return replace(
        done,
        answer=replace(done.answer, notes=notes, verdict=verdict, sensors=measured, first=first),
    )


def opened(
    config: DiagnosisConfig,
    recordings: Sequence[Recording],
    baseline: Sequence[Recording] = (),
) -> Case:
    """Recordings and simulator, ready to be searched; the arguments are those of `diagnose`."""
    simulation = Simulation(maker(config, options=_step(config, recordings).options))
    simulation, library, _ = _measured(config, simulation, recordings, own=not baseline)
    stages, drives = Stages(None, config), (recordings, baseline)
    return _case(config, simulation, library, drives, stages, lambda _: None)[0]


def maker(
    config: DiagnosisConfig,
    parameters: Mapping[str, float] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Maker:
    """Builds the simulator for a number of environments, once for each number."""
    engine = _engine(config.simulator)
    threads: dict[str, Any] = {"nthread": config.threads} if engine == "mujoco" else {}
    return Maker(config.simulator, parameters, {**threads, **_own(config), **(options or {})})


def _own(config: DiagnosisConfig) -> dict[str, Any]:
    """Options of an engine of ours that the question says; a user's own factory takes none."""
    engine, own = _engine(config.simulator), dict[str, Any]()
    if engine in ENGINES or engine.endswith(".pt"):
        own |= {} if config.dt == CONTROL_PERIOD else {"dt": config.dt}
    if config.car and str(config.simulator) in ENGINES:  # a file says itself which car it is
        own["car"] = config.car
    return own


def _preflight(
    config: DiagnosisConfig, recordings: Sequence[Recording], baseline: Sequence[Recording]
) -> tuple[list[str], list[str]]:
    """Notes, and what the answer begins with."""
    notes, first = list[str](), list[str]()
    for drives in (recordings, baseline) if baseline else (recordings,):
        notes += check_drives(drives, config.seconds, config.dt)
        commands = check_commands(drives)
        notes, first = [*notes, *commands.notes], [*first, *commands.first]
    make = maker(config)
    notes += check_simulator(make, simulator_name(config.simulator), config.dt)
    refuse_another_rest([*recordings, *baseline], make(1))
    inside = [effect.name for effect in effects_of(make(1))]
    if inside:
        notes.append(f"the simulator has {', '.join(inside)} already: not looked for again")
    return notes, first


def _measured(
    config: DiagnosisConfig,
    simulation: Simulation,
    recordings: Sequence[Recording],
    own: bool,
    seconds: float = 0.0,
) -> tuple[Simulation, Library, list[str]]:
    """With what effects must know of the simulator, what it may lack, and notes."""
    make, apart = simulation.make, partial(simulation.workers.results, seconds=seconds)
    own = own if config.parameters is None else config.parameters
    inside = [effect.name for effect in effects_of(make(1))]
    black_box = config.parameters is False
    realises = {} if black_box else getattr(make(1), "realises", {})
    declared = getattr(make(1), "declared", {}) if own or realises else {}
    declared = {name: bounded_by(body_of(make(1)), p) for name, p in declared.items()}
    derived = set.intersection(*(set(r.derived) for r in recordings))
    names = config.effects or offered(declared_by(make(1)), derived)
    scale = _similarity(config, make)
    library = Library([e for e in names if e not in inside], declared, own, realises, scale)
    options, notes = measurable_options(make, apart, *_of_the_file(config))
    left_out = [n for n, column in OF_A_COLUMN.items() if column in derived]
    if left_out and not config.effects:
        notes.append(
            f"{', '.join(sorted(derived))} follow from the pose in all recordings: "
            f"{', '.join(left_out)} cannot be told and are not looked for"
        )
    return replace(simulation, options=options), library, notes


def _of_the_file(config: DiagnosisConfig) -> tuple[VehicleDimensions | None, float | None]:
    """Dimensions and largest road-wheel angle [rad] of the car, where a file says them."""
    if not config.car:
        return None, None
    car = load_car(config.car)
    locks = [angle for angle in (car.steering.left, car.steering.right) if angle]
    return car.vehicle, max(locks, default=None)


def _similarity(config: DiagnosisConfig, make: Callable[[int], Any]) -> Similarity:
    """Ratios of the car to the buggy; without a car's file those of the simulator."""
    if config.car:
        return load_car(config.car).similarity
    return getattr(make(1), "similarity", Similarity())


def _case(
    config: DiagnosisConfig,
    simulation: Simulation,
    library: Library,
    drives: tuple[Sequence[Recording], Sequence[Recording]],
    stages: Stages,
    progress: Progress,
    budget: Budget = FULL,
) -> tuple[Case, Correction | None]:
    """What is computed with of recordings and of a baseline, and the baseline's correction."""
    recordings, baseline = drives
    if not baseline:
        return prepared(simulation, recordings, library, config, budget=budget), None
    before = segments_of(baseline, config, budget)
    correction = stages.done("correction", lambda: correct(simulation, before, 0, progress))
    simulation = correction.simulation(simulation)
    case = prepared(simulation, recordings, library, config, correction.covariance, budget)
    others = len(case.criteria.group.unique())
    criteria = replace(
        case.criteria,
        usual=baseline_misfit(correction.held_out, blocks(before), others),
        baseline=Problem(simulation, before, correction.noise, library),
    )
    return replace(case, criteria=criteria), correction


def _checked(case: Case, name: str) -> list[str]:
    problem, residuals = case.problem, case.problem.noise.about
    assert residuals is not None  # nothing has been searched: they are of the simulator as given
    instants = problem.simulation.instants(problem.segments)
    return check_residuals(residuals, problem.segments, instants, case.names, name)


def _searched(case: Case, progress: Progress, kept: Keep) -> SearchResult:
    found = joint_search(
        case.problem, case.criteria, progress=progress, budget=case.budget, kept=kept
    )
    tried = {w.candidate.key: w.candidate for w in found.weighed}
    return concluded(case.criteria, found, same_sets(tried, found.problem.segments))


def _diagnosed(
    config: DiagnosisConfig,
    case: Case,
    stages: Stages,
    stage: str,
    meter: Meter,
    tuned: Retuned | None = None,
) -> Diagnosis:
    """Searches and answers, or takes what was kept under the stage's name."""
    meter.stage("search")

    def kept(name: str, compute: Callable[[], Any]) -> Any:
        return stages.done(f"{stage}{name}", compute)

    found = kept("search", lambda: _searched(case, meter.says, kept))
    case = replace(case, problem=found.problem(case.problem))
    meter.stage("answer")
    said = stages.done(f"{stage}answer", lambda: answered(case, found, meter.says, tuned))
    return Diagnosis(case, found, said)


def left_open(posterior: Posterior, named: Effects, proof: Proof) -> bool:
    """Whether parameters of the simulator may be off: it is re-tuned then, and searched again."""
    unsure = not decided(posterior, named) and proof.prefers_retuning
    return posterior.says == "unknown" or unsure


def _retuned_first(
    config: DiagnosisConfig, done: Diagnosis, stages: Stages, meter: Meter
) -> Diagnosis:
    """Looks again with all parameters of the simulator fitted; the better answer of both.

    A few effects explain a simulator that is right but for them. One that was never fitted to this
    car is wrong in everything a little, and missing physics shows only after that.
    """
    given = done.case.problem.simulation
    first = replace(done.case, problem=replace(done.case.problem, dispersion=1.0))
    tuned = stages.done("retuning", lambda: retuned(first, meter.says))
    make = maker(config, tuned.values, done.step)
    simulation = replace(
        given, make=make, options=measurable_options(make, in_turn, *_of_the_file(config))[0]
    )
    declared = getattr(make(1), "declared", {})
    library = done.case.problem.library
    library = Library(library.effects, declared, own=False, similarity=library.similarity)
    budget = done.case.budget
    case = prepared(simulation, done.case.recordings, library, config, budget=budget)
    case = replace(case, retuned_from=given)
    again = _diagnosed(config, case, stages, "second_", meter, tuned)
    if not again.answer.proof.better_than(done.answer.proof):
        return done
    return replace(again, tuned=tuned.values, step=done.step)


def _step(config: DiagnosisConfig, recordings: Sequence[Recording]) -> Step:
    """That the simulator needs for these recordings; a user's own factory takes no options."""
    if _engine(config.simulator) not in ENGINES:
        return Step()
    return fine_enough(
        lambda options: Simulation(maker(config, options=options)),
        segments_of(recordings, config),
        config.search.finer_step_gain,
    )


def _engine(simulator: str | Factory) -> str:
    """The engine of a simulator file; none of a factory."""
    if callable(simulator):
        return ""
    while simulator.endswith((".yaml", ".yml")):
        simulator = str(read_simulator(Path(simulator))["engine"])
    return simulator
