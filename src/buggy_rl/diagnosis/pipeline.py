"""From drives and a simulator to the answer, stage by stage."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from buggy_rl.diagnosis.answer import Answer
from buggy_rl.diagnosis.case import Case, prepared, stretches_of
from buggy_rl.diagnosis.confidence import SOUND
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.integration import Step, fine_enough
from buggy_rl.diagnosis.preflight_recordings import (
    check_blocks,
    check_clock,
    check_drives,
    check_gaps,
    check_latency,
)
from buggy_rl.diagnosis.preflight_simulator import blaming, check_simulator
from buggy_rl.diagnosis.retuning import retuned
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.diagnosis.stages import Stages
from buggy_rl.diagnosis.statement import stated
from buggy_rl.effects import EFFECTS
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.engines import ENGINES, read_simulator
from buggy_rl.estimation.baseline import Correction, correct
from buggy_rl.estimation.cross_validation import blocks
from buggy_rl.estimation.gauss_newton import Fitter
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.misfit import usual
from buggy_rl.estimation.noise_model import Likelihood
from buggy_rl.estimation.rollout import Player, effects_of
from buggy_rl.recordings import Recording
from buggy_rl.task.env import make_simulator


@dataclass
class Diagnosis:
    """The answer, and what it was come by."""

    case: Case
    search: Search
    found: Found
    answer: Answer
    correction: Correction | None = None
    """Of what the simulator got wrong before anything changed, where baseline drives were given."""
    tuned: dict[str, float] | None = None
    """The simulator's own parameters, where it had to be re-tuned first."""
    step: dict[str, Any] = field(default_factory=dict)
    """Options of the simulator with which it integrates finely enough, where it did not."""


def identified(
    case: Case,
    progress: Callable[[str], None] = lambda _: None,
    baseline: Fitter | None = None,
) -> tuple[Found, Likelihood]:
    """Names what is missing; what the baseline lacks as well is not.

    Returns:
        What was found, and how the gaps were weighed at last.
    """
    fitter = Fitter(case.player, case.cut, case.likelihood, case.library)
    found = Search(fitter, progress, baseline, case.usual).run()
    return found, fitter.likelihood


def diagnose(
    config: DiagnosisConfig,
    recordings: Sequence[Recording],
    progress: Callable[[str], None] = lambda _: None,
    baseline: Sequence[Recording] = (),
    kept: Path | None = None,
) -> Diagnosis:
    """Compares a simulator with drives.

    With baseline drives, on which it counts as right, its standing faults are closed on them
    first, and what is found is what has changed since.

    Args:
        config: The question.
        recordings: Drives that the simulator should have foretold.
        progress: Told in plain words what is being done.
        baseline: Drives on which it was right.
        kept: Folder in which stages are kept, so that an interrupted diagnosis goes on from them.

    Raises:
        ValueError: The drives cannot be used, or the simulator does not do what one must; the
            message says which and what to do.
    """
    make = _maker(config)
    stages = Stages(kept, config, [*recordings, *baseline])
    progress("looking at drives and simulator")
    notes = check_drives(recordings, config.seconds)
    if baseline:
        notes += check_drives(baseline, config.seconds)
    notes += check_simulator(make, config.simulator)
    own = not baseline if config.parameters is None else config.parameters
    declared = getattr(make(1), "declared", {}) if own else {}
    inside = [effect.name for effect in effects_of(make(1))]
    if inside:
        notes.append(f"the simulator has {', '.join(inside)} already: not looked for again")
    library = Library([e for e in config.effects or EFFECTS if e not in inside], declared)
    with blaming(config.simulator):
        step = _step(config, recordings)
        make = _maker(config, options=step.options)
        options, failures = measurable_options(make)
        notes += failures
        player, correction = Player(make, options=options), None
        before = stretches_of(baseline, config) if baseline else None
        if before is not None:
            correction = stages.done("correction", lambda: correct(player, before, 0, progress))
            player = correction.player(player)
            notes.append(correction.note)
        extra = None if correction is None else correction.covariance
        case = prepared(player, recordings, library, config, extra)
        short = check_blocks(case.cut)
        gap = player.play(case.cut, {})[0]
        instants = player.instants(case.cut)
        notes += check_gaps(gap, case.cut, instants, case.names, config.simulator)
        right = None
        if before is not None and correction is not None:
            right = Fitter(player, before, correction.weighed, library)
            others = len(blocks(case.cut).unique())
            case.usual = usual(correction.held_out, blocks(before), others)
        found, case.likelihood = stages.done("search", lambda: identified(case, progress, right))
        search = Search.after(Fitter(player, case.cut, case.likelihood, library), found)
        said = stages.done("answer", lambda: stated(case, search, found, progress))
        done = Diagnosis(case, search, found, said, correction, step=step.options)
        if declared and not baseline and said.remaining.share > SOUND:
            done = _retuned_first(config, done, stages, progress)
    notes += (
        short
        + ([step.note] if step.note else [])
        + check_clock(done.found.best.fitted.values()[""]["clock_offset"])
    )
    notes += check_latency(done.found.best.causes)
    verdict = "cannot_tell" if short else done.answer.verdict
    return replace(done, answer=replace(done.answer, notes=notes, verdict=verdict))


def _retuned_first(
    config: DiagnosisConfig, done: Diagnosis, stages: Stages, progress: Callable[[str], None]
) -> Diagnosis:
    """Looks again with all parameters of the simulator fitted; the better answer of both.

    A few causes explain a simulator that is right but for them. One that was never fitted to this
    car is wrong in everything a little, and what physics is missing shows only after that.
    """
    given = done.case.player
    tuned = stages.done("retuning", lambda: retuned(done.case, progress))
    make = _maker(config, tuned.values, done.step)
    player = replace(given, make=make, options=measurable_options(make)[0])
    declared = getattr(make(1), "declared", {})
    library = Library(done.case.library.effects, declared, own=False)
    case = prepared(player, done.case.recordings, library, config)
    case.retuned_from = given
    found, case.likelihood = stages.done("second_search", lambda: identified(case, progress))
    search = Search.after(Fitter(player, case.cut, case.likelihood, library), found)
    said = stages.done("second_answer", lambda: stated(case, search, found, progress, tuned.wrong))
    if not said.proof.better_than(done.answer.proof):
        return done
    return Diagnosis(case, search, found, said, tuned=tuned.values, step=done.step)


def _step(config: DiagnosisConfig, recordings: Sequence[Recording]) -> Step:
    """That the simulator needs for these drives; a user's own factory is not asked for another."""
    if _engine(config.simulator) not in ENGINES:
        return Step()
    cut = stretches_of(recordings, config)
    return fine_enough(lambda options: Player(_maker(config, options=options)), cut)


def _maker(
    config: DiagnosisConfig,
    parameters: Mapping[str, float] | None = None,
    options: Mapping[str, Any] | None = None,
) -> Callable[[int], EnvBase]:
    """Builds the simulator for a number of cars, once for each number."""
    threads: dict[str, Any] = (
        {"nthread": config.threads} if _engine(config.simulator) == "mujoco" else {}
    )

    @cache
    def make(cars: int) -> EnvBase:
        own = {**threads, **(options or {})}
        return make_simulator(config.simulator, cars, parameters=parameters, **own)

    return make


def _engine(simulator: str) -> str:
    """What is at the bottom of a simulator file."""
    while simulator.endswith((".yaml", ".yml")):
        simulator = str(read_simulator(Path(simulator))["engine"])
    return simulator
