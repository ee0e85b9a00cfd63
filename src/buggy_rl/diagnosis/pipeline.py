"""The diagnosis: from recordings and a simulator to the answer, stage by stage."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

from buggy_rl.diagnosis.answer import behaviour, experiments, located, statement
from buggy_rl.diagnosis.answer.answer import Answer
from buggy_rl.diagnosis.answer.equivalents import equivalents
from buggy_rl.diagnosis.answer.other_sensors import other_sensors
from buggy_rl.diagnosis.answer.retuning import left_open, retuned
from buggy_rl.diagnosis.answer.terms import named_terms
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.preflight.commands import CommandCheck, check_commands
from buggy_rl.diagnosis.preflight.recordings import check_drives
from buggy_rl.diagnosis.preflight.simulator import blaming, check_simulator
from buggy_rl.diagnosis.repair import proof
from buggy_rl.diagnosis.run.case import DiagnosisCase, Drives, check_case, prepare_case
from buggy_rl.diagnosis.run.maker import (
    Maker,
    measured_again,
    open_simulator,
    own_options,
)
from buggy_rl.diagnosis.run.meter import Meter, MeterReading
from buggy_rl.diagnosis.run.plan import plan_of
from buggy_rl.diagnosis.run.stages import Stages
from buggy_rl.diagnosis.search.by_recording import ByRecording, Difference, by_recording
from buggy_rl.diagnosis.search.joint import Admits, Keep, joint_search
from buggy_rl.diagnosis.search.limits import limits_within, same_sets
from buggy_rl.diagnosis.search.observed import concluded
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.baseline import Correction, correct
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.workers import Workers
from buggy_rl.recordings import Recording
from buggy_rl.recordings.recording import refuse_another_rest
from buggy_rl.simulators import simulator_name
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
    with blaming(name), Workers(count) as workers:
        every = Drives.cut(config, recordings, baseline)
        simulation = partial(Simulation, workers=workers, rolled=meter.rolled)
        opened = open_simulator(config, every, simulation, begun)
        given, library, limits = opened.simulation, opened.library, limits_within(opened.library)
        short = SHORT if seen.first else ""
        plan = stages.done(
            "plan",
            lambda: plan_of(given, library, every, config.minutes, begun, short, limits),
        )
        meter.begin(plan, deadline=begun + (60 * config.minutes or math.inf))

        drives = every.within(plan.budget)
        correction = _corrected(given, drives, stages, progress)
        case = prepare_case(given, drives, library, config, correction, plan.budget)
        notes = [
            *(*seen.notes, *opened.notes, *plan.notes),
            *([correction.note] if correction else []),
            *check_case(case, name),
            *([opened.step.note] if opened.step.note else []),
        ]
        options = {**own_options(config), **opened.step.options}
        done = _diagnosed(case, options, stages, "", meter)
        done = _retuned_too(config, done, stages, meter, bool(seen.first and config.minutes))

    said = done.answer
    notes += [f"left out: {part}; minutes={config.minutes:g} were up" for part in said.left_out]
    undecidable = case.one_block or bool(seen.first)
    answer = replace(
        said,
        notes=[*notes, *said.notes],
        verdict="cannot_tell" if undecidable else said.verdict,
        sensors=other_sensors(recordings),
        first=seen.first,
    )
    return replace(done, answer=answer)


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


def _corrected(
    simulation: Simulation, drives: Drives, stages: Stages, progress: Progress
) -> Correction | None:
    """The correction of what the simulator gets wrong on the baseline, where there is one."""
    before = drives.baseline
    if before is None:
        return None
    return stages.done("correction", lambda: correct(simulation, before, 0, progress))


def _diagnosed(
    case: DiagnosisCase,
    options: dict[str, Any],
    stages: Stages,
    stage: str,
    meter: Meter,
    differences: Sequence[Difference] = (),
) -> Diagnosed:
    """Searches and answers, or takes what was kept under the stage's name.

    Where most of what is left differs between recordings, what they share is searched for anew.

    Args:
        case: The question.
        options: Of the simulator, with which it integrates finely enough.
        stages: Of the diagnosis.
        stage: What the names of this one's stages begin with.
        meter: Of the diagnosis.
        differences: Between recordings, that the case's noise model has already.
    """
    meter.stage("search")

    def kept(name: str, compute: Callable[[], Any]) -> Any:
        return stages.done(f"{stage}{name}", compute)

    found = kept("search", lambda: _searched(case, meter, kept))
    if case.apart is None:
        apart = kept("by_recording", lambda: _by_recording(case, found))
        differences = apart.differences
        if differences and meter.admits("retuning"):
            meter.says("looking for what all recordings share")
            case = case.with_apart(apart.covariance)
            found = kept("shared", lambda: _searched(case, meter, partial(_keeping, kept)))
        elif differences:
            left_out = (*found.left_out, "searching for what all recordings share")
            found = replace(found, left_out=left_out)
    case = replace(case, problem=found.problem(case.problem))
    meter.stage("answer")
    said = kept("answer", lambda: answered(case, found, meter.says, meter.admits))
    return Diagnosed(case, found, replace(said, by_recording=list(differences)), options)


def _by_recording(case: DiagnosisCase, found: SearchResult) -> ByRecording:
    problem = found.problem(case.problem)
    return by_recording(case.criteria, problem, found.null, found.predictive, case.names)


def _keeping(kept: Keep, name: str, compute: Callable[[], Any]) -> Any:
    """Keeps parts of a second search under names of their own."""
    return kept(f"shared_{name}", compute)


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


@dataclass(frozen=True)
class Section:
    """A part of the answer."""

    doing: str
    """What is told to be done; empty for what takes no time."""
    say: Callable[[DiagnosisCase, SearchResult], Mapping[str, Any]]
    """Case and what a search found -> field of `Answer` -> what it holds."""
    parts: Mapping[Literal["terms", "longer", "experiments"], str] = field(default_factory=dict)
    """Part of the plan, and field of the budget, that is given up where there is no time -> what
    is left out then, in words."""


SECTIONS = (
    Section("locating the error", located.answer_section),
    Section("", statement.answer_section),
    Section("step tests of both simulators", behaviour.answer_section),
    Section(
        "proving it on what was held out",
        proof.answer_section,
        {"terms": "equations without a name", "longer": "errors beyond the segments"},
    ),
    Section(
        "looking for what to drive next",
        experiments.answer_section,
        {"experiments": "what to drive next"},
    ),
)


def answered(
    case: DiagnosisCase,
    found: SearchResult,
    progress: Progress = lambda _: None,
    admits: Admits = lambda _: True,
) -> Answer:
    """The answer, section by section.

    Args:
        case: Recordings and simulator, with the noise model that the search came to.
        found: What it found.
        progress: Told what is being done.
        admits: Whether there is time for what may be left out.
    """
    parts: dict[str, Any] = {}
    left_out = [*found.left_out]
    for section in SECTIONS:
        if section.doing:
            progress(section.doing)
        asked = case
        for part, words in section.parts.items():
            if not admits(part):
                nothing: dict[str, Any] = {part: 0}
                asked = replace(asked, budget=replace(asked.budget, **nothing))
                left_out.append(words)
        parts |= section.say(asked, found)
    answer = Answer(**parts, left_out=left_out)
    return replace(
        answer,
        equivalents=equivalents(case, found, answer.effects, answer.manoeuvres),
        terms=named_terms(case, found, answer.layers),
    )


def _retuned_too(
    config: DiagnosisConfig, done: Diagnosed, stages: Stages, meter: Meter, short: bool
) -> Diagnosed:
    """Looks again with all parameters of the simulator fitted, where they may be off.

    A few effects explain a simulator that is right but for them. One that was never fitted to this
    car is wrong in everything a little, and missing physics shows only after that. On a baseline
    its parameters were right.

    Args:
        config: The question.
        done: With the simulator as it was given.
        stages: Of the diagnosis.
        meter: Of the diagnosis.
        short: Whether nothing is looked at again.

    Returns:
        The better one of both.
    """
    case, answer = done.case, done.answer
    if short or case.drives.baseline is not None or not case.problem.library.parameters:
        return done
    if not left_open(done.found.posterior, done.found.best.effects, answer.proof):
        return done
    if not meter.admits("retuning"):
        left_out = [*answer.left_out, "re-tuning the simulator's own parameters"]
        return replace(done, answer=replace(answer, left_out=left_out))
    given = case.problem.simulation
    first = replace(case, problem=replace(case.problem, dispersion=1.0))
    tuned = stages.done("retuning", lambda: retuned(first, meter.says))
    make = replace(cast(Maker, given.make), parameters=tuned.values, _built={})
    opened = measured_again(config, given, make, case.problem.library)
    second = prepare_case(
        opened.simulation,
        case.drives,
        opened.library,
        config,
        budget=case.budget,
        apart=case.apart,
    )
    second = replace(second, retuned_from=given, tuned=tuned)
    again = _diagnosed(second, done.step, stages, "second_", meter, answer.by_recording)
    return again if again.answer.proof.better_than(answer.proof) else done


def open_case(
    config: DiagnosisConfig,
    recordings: Sequence[Recording],
    baseline: Sequence[Recording] = (),
) -> DiagnosisCase:
    """Recordings and simulator, ready to be searched; arguments as of `run_diagnosis`."""
    drives = Drives.cut(config, recordings, baseline)
    opened = open_simulator(config, drives)
    correction = _corrected(opened.simulation, drives, Stages(None, config), lambda _: None)
    return prepare_case(opened.simulation, drives, opened.library, config, correction)
