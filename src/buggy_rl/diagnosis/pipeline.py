"""From drives and a simulator to the answer, stage by stage."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from omegaconf import MISSING
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.diagnosis.adequacy import NOTHING, Remaining, misfit, remaining
from buggy_rl.diagnosis.answer import Answer, Named, Proof, Value, Verdict, sentence
from buggy_rl.diagnosis.confidence import SOUND, confidences
from buggy_rl.diagnosis.correction import FILE, Correction, correct
from buggy_rl.diagnosis.excitation import suggestions, weak
from buggy_rl.diagnosis.fit import Fitter
from buggy_rl.diagnosis.guard import (
    blaming,
    check_blocks,
    check_clock,
    check_drives,
    check_gaps,
    check_latency,
    check_simulator,
)
from buggy_rl.diagnosis.library import OWN, Library
from buggy_rl.diagnosis.likelihood import Likelihood, likelihood
from buggy_rl.diagnosis.locate import locate
from buggy_rl.diagnosis.proof import prove
from buggy_rl.diagnosis.rollouts import Player, effects_of
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.diagnosis.stretches import Stretches, stretches
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.engines import read_simulator
from buggy_rl.env import make_simulator
from buggy_rl.recordings import Recording

UNDECIDED = 0.5  # confidence below which an answer is no answer
NORMAL = 1.96  # standard deviations of a 95 % interval


@dataclass(frozen=True)
class DiagnosisConfig:
    """What is compared with what."""

    simulator: str = MISSING
    """Any engine, .yaml, .pt or file.py:factory."""
    recordings: list[str] = MISSING
    """Drives that it should have foretold."""
    baseline: list[str] = field(default_factory=list)
    """Drives on which it was right; then what is reported is what changed."""
    output: str = MISSING
    """Folder for diagnosis.json, repaired.yaml and report.html."""
    columns: str = ""
    """YAML column map, for tables that do not have the standard columns."""
    effects: list[str] = field(default_factory=list)
    """Effects to choose from; empty for the whole library. One's own as file.py:Class."""
    parameters: bool | None = None
    """Whether the simulator's own parameters may be what is wrong; if not said, they may unless
    baseline drives show that they are right."""
    seconds: float = 1.0
    """Length of a rollout that is fitted."""
    stretches: int = 150
    """Most of them, spread evenly over the drives."""
    threads: int = 1
    """Threads of PyTorch."""


@dataclass
class Case:
    """A question, cut into what is computed with."""

    player: Player
    cut: Stretches
    likelihood: Likelihood
    library: Library
    names: list[str]
    recordings: Sequence[Recording]


@dataclass
class Diagnosis:
    """The answer, and what it was come by."""

    case: Case
    search: Search
    found: Found
    answer: Answer
    correction: Correction | None = None
    """Of what the simulator got wrong before anything changed, where baseline drives were given."""


def identify(
    case: Case,
    progress: Callable[[str], None] = lambda _: None,
    baseline: Stretches | None = None,
) -> tuple[Search, Found]:
    """Names what is missing; what baseline stretches lack as well is not."""
    fitter = Fitter(case.player, case.cut, case.likelihood, case.library)
    before = None
    if baseline is not None:
        weighed = likelihood(case.player, baseline, extra=case.likelihood.extra)
        before = Fitter(case.player, baseline, weighed, case.library)
    search = Search(fitter, progress, before)
    found = search.run()
    case.likelihood = fitter.likelihood  # as it was weighed at last
    return search, found


def answer(case: Case, search: Search, found: Found, progress=lambda _: None) -> Answer:
    """Says it, with what speaks for it."""
    progress("locating the error")
    located = locate(case.player, case.cut, case.likelihood.noise, case.names)
    instants = case.player.instants(case.cut)
    rest = remaining(case.cut, instants, found.null.fitted.white, found.best.fitted.white)
    sure = confidences(search, found, rest.share)
    progress("proving it on what was held out")
    proof = _proof(case, found)
    named = [_named(case, found, c, sure[c]) for c in found.best.causes]
    named.sort(key=lambda n: -n.held_out_gain)
    verdict = _verdict(found, rest, named)
    undecided = []
    for item in named:
        for rival in item.confused_with:
            others = tuple(sorted({*found.best.causes} - {item.name} | {rival}))
            if others in found.tried:
                undecided.append((found.best.fitted, found.tried[others].fitted))
    progress("looking for what to drive next")
    suggest = suggestions(
        case.player, case.library, undecided[:3], case.likelihood.noise, case.cut.dt
    )
    return Answer(verdict, located, named, rest, proof, weak(case.cut), suggest)


def _verdict(found: Found, rest: Remaining, named: Sequence[Named]) -> Verdict:
    if misfit(found.null.held_out) - 1 < NOTHING and not named:
        return "no_mismatch"
    if not named or rest.share > SOUND:
        return "unknown_physics" if rest.excess > NOTHING else "no_mismatch"
    if max(n.confidence for n in named) < UNDECIDED:
        return "cannot_tell"
    if all(n.kind == "parameter" for n in named):
        return "wrong_parameters"
    return "missing_physics"


def _named(case: Case, found: Found, cause: str, sure) -> Named:
    fitted = found.best.fitted
    spread = found.best.evidence.covariance.diagonal().clamp_min(0.0).sqrt()
    values: dict[str, Value] = {}
    bound = []
    for unknown, z, sd in zip(fitted.unknowns, fitted.place.tolist(), spread.tolist(), strict=True):
        if unknown.cause != cause:
            continue
        p = unknown.parameter
        ends = sorted(p.value_at(z + k * NORMAL * sd) for k in (-1, 0, 1))
        values[p.name] = Value(float(p.value_at(z)), float(ends[0]), float(ends[-1]), p.unit)
        if min(abs(p.value_at(z) - p.lower), abs(p.value_at(z) - p.upper)) < 1e-6 * p.size:
            bound.append(p.name)
    numbers = {name: v.value for name, v in values.items()}
    own = cause.startswith(OWN)
    kind = "parameter" if own else effect_class(cause).kind
    p = case.library.numbers(cause)[0]
    return Named(
        name=cause,
        kind=kind,
        equation="" if own else effect_class(cause).equation,
        sentence=sentence(cause, numbers, p.unit, p.value),
        parameters=values,
        confidence=sure.sure,
        held_out_gain=_gain(found, cause),
        confused_with=sure.rivals,
        at_bound=tuple(bound),
    )


def _gain(found: Found, cause: str) -> float:
    """Share of the gap that comes back without a cause, on what was held out."""
    key = tuple(sorted(set(found.best.causes) - {cause}))
    without = found.tried.get(key, found.null)

    before, after = misfit(without.held_out) - 1, misfit(found.best.held_out) - 1
    return max(0.0, before - after) / max(before, 1e-9)


def _proof(case: Case, found: Found) -> Proof:
    best = found.best.fitted
    errors = prove(case.player, case.recordings, case.cut, case.likelihood, case.library, best)
    floor = 2 * float(case.likelihood.noise[:2].square().sum())
    return Proof(
        before=errors["before"],
        after=errors["after"],
        retuned=errors.get("retuned", {}),
        noise_floor={h: floor for h in errors["before"]},
        black_box=errors["black_box"],
        misfit_before=misfit(found.null.held_out),
        misfit_after=misfit(found.best.held_out),
        held_out=True,
    )


def prepared(
    player: Player,
    recordings: Sequence[Recording],
    library: Library,
    config: DiagnosisConfig,
    extra: Tensor | None = None,
) -> Case:
    """Cuts drives and weighs their noise."""
    cut = _cut(recordings, config)
    weighed = likelihood(player, cut, extra=extra)
    return Case(player, cut, weighed, library, [r.name for r in recordings], recordings)


def _cut(recordings: Sequence[Recording], config: DiagnosisConfig) -> Stretches:
    cut = stretches(recordings, config.seconds, config.seconds)
    if len(cut) > config.stretches:
        rows = torch.linspace(0, len(cut) - 1, config.stretches).round().long()
        cut = cut[rows]
    return cut


def diagnose(
    config: DiagnosisConfig,
    recordings: Sequence[Recording],
    progress: Callable[[str], None] = lambda _: None,
    baseline: Sequence[Recording] = (),
) -> Diagnosis:
    """Compares a simulator with drives.

    With baseline drives, on which it counts as right, its standing faults are closed on them
    first, and what is found is what has changed since.

    Raises:
        ValueError: The drives cannot be used, or the simulator does not do what one must; the
            message says which and what to do.
    """
    engines: dict[int, EnvBase] = {}
    threads: dict[str, Any] = (
        {"nthread": config.threads} if _engine(config.simulator) == "mujoco" else {}
    )

    def make(cars: int) -> EnvBase:
        if cars not in engines:
            engines[cars] = make_simulator(config.simulator, cars, **threads)
        return engines[cars]

    progress("looking at drives and simulator")
    notes = check_drives(recordings, config.seconds)
    if baseline:
        notes += check_drives(baseline, config.seconds)
    notes += check_simulator(make, config.simulator)
    own = not baseline if config.parameters is None else config.parameters
    declared = getattr(make(1), "parameters", {}) if own else {}
    inside = [effect.name for effect in effects_of(make(1))]
    if inside:
        notes.append(f"the simulator has {', '.join(inside)} already: not looked for again")
    library = Library([e for e in config.effects or EFFECTS if e not in inside], declared)
    with blaming(config.simulator):
        options, failures = measurable_options(make)
        notes += failures
        player, correction = Player(make, options=options), None
        before = _cut(baseline, config) if baseline else None
        if before is not None:
            correction = correct(player, before, progress=progress)
            player = correction.player(player)
        cut = _cut(recordings, config)
        short = check_blocks(cut)
        names = [recording.name for recording in recordings]
        gap = player.play(cut, {})[0]
        notes += check_gaps(gap, cut, player.instants(cut), names, config.simulator)
        extra = None if correction is None else correction.covariance
        case = prepared(player, recordings, library, config, extra)
        search, found = identify(case, progress, before)
        said = answer(case, search, found, progress)
    notes += short + check_clock(found.best.fitted.values()[""]["clock_offset"])
    notes += check_latency(found.best.causes)
    said = replace(said, notes=notes, verdict="cannot_tell" if short else said.verdict)
    return Diagnosis(case, search, found, said, correction)


def _engine(simulator: str) -> str:
    """What is at the bottom of a simulator file."""
    while simulator.endswith((".yaml", ".yml")):
        simulator = str(read_simulator(Path(simulator))["engine"])
    return simulator


def repaired(simulator: str, done: Diagnosis, folder: Path) -> dict[str, Any]:
    """The simulator with what was found in it, as a simulator file has it.

    A correction stays in it as what it is; its network lies beside the file, as `FILE`.
    """
    correction, options = done.correction, done.case.player.options
    content: dict[str, Any] = {"engine": simulator}
    if simulator.endswith((".yaml", ".yml", ".pt")) or ".py:" in simulator:
        content["engine"] = os.path.relpath(simulator, folder)
    effects, parameters = {}, {}
    if correction is not None and correction.effect is not None:
        strength = float(correction.effect.values["strength"])
        effects[correction.effect.name] = {"strength": strength, "model": FILE}
    for named in done.answer.effects:
        values = {name: value.value for name, value in named.parameters.items()}
        if named.kind == "parameter":
            parameters.update(values)
        else:
            effects[named.name] = {**values, **options.get(named.name, {})}
    if parameters:
        content["parameters"] = parameters
    if effects:
        content["effects"] = effects
    return content
