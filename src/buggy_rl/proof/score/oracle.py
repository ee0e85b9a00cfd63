"""What could be known of a case: its true structure, fitted to the drives that the tool had."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.effects import offered
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.estimation.baseline import correct
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import Hypothesis, Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments, cut_segments
from buggy_rl.estimation.sparse import screened
from buggy_rl.proof.cases.case import Case, Concealing
from buggy_rl.proof.cases.equivalents import expected
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.recordings import ColumnMap, load_recordings
from buggy_rl.recordings.columns import load_columns

SECONDS = 1.0  # [s] of a rollout
ITERATIONS = 8  # of a fit
MEASURED = 150  # segments of sealed recordings, at most, on which errors are measured


def described(case: Case) -> bool:
    """Whether effects describe what is concealed, and something is."""
    return bool(case.truth) and set(case.truth) <= set(offered(case.longitudinal))


def weighed(store: CaseStore, case: Case, effects: Sequence[str], rivals: int) -> dict[str, Any]:
    """What `weigh` writes: losses in nats, parameters, alternatives, errors on sealed drives."""
    seen = store.inputs(case.id)
    question = yaml.safe_load((seen / "question.yaml").read_text())
    most = question.get("stretches", DiagnosisConfig.stretches)
    make = Maker(str(seen / question["simulator"]))
    simulation = Simulation(make, options=measurable_options(make)[0])
    extra, columns = None, None
    if "columns" in question:
        columns = load_columns(seen / question["columns"])
    if case.baseline:
        correction = correct(simulation, _cut(seen / "baseline", most, columns))
        simulation, extra = correction.simulation(simulation), correction.covariance
    segments, library = _cut(seen / "recordings", most, columns), Library(list(effects) or None)
    noise = noise_model(simulation, segments, extra=extra)
    problem = Problem(simulation, segments, noise, library)
    [null] = fitted(problem, [library.hypothesis(())], ITERATIONS)
    truth: Fit | None = None
    result: dict[str, Any] = {"null": problem.cost(null)}
    if described(case):
        problem, truth = true_fit(problem, true_numbers(case))
        own = problem.cost(truth)
        result |= {
            "temper": problem.dispersion,
            "nats": problem.cost(null) - own,
            "parameters": {e: v for e, v in truth.values().items() if e},
        }
        single = len(case.truth) == 1
        starts = _others(problem, null, truth, rivals) if single else _fewer(problem, truth)
        found = fitted(problem, starts, ITERATIONS)
        result["rivals"] = {"+".join(f.effects): problem.cost(f) - own for f in found}
    held_out = replace(problem, segments=_cut(store.held_out(case.id), MEASURED, columns))
    repaired = store.diagnosis(case.id) / "repaired.yaml"
    result["held_out"] = _measured(held_out, null, truth, repaired)
    return result


Numbers = Mapping[str, Mapping[str, float]]
"""Effect -> parameter -> value."""


def true_numbers(case: Concealing) -> dict[str, dict[str, float]]:
    """What is concealed in a case, by the numbers that a right answer has."""
    return {effect: expected(case, effect) for effect in case.truth}


def true_fit(problem: Problem, truth: Numbers) -> tuple[Problem, Fit]:
    """The true structure, fitted from the true numbers on, and the dispersion that it expects."""
    first = _truth(problem, truth)
    # The truth's own misfit is the dispersion that is expected.
    dispersion = max(1.0, float(first.square.median()) / problem.noise.dimension)
    problem = replace(problem, dispersion=dispersion)
    [found] = fitted(problem, [first], ITERATIONS)
    return problem, found


def _truth(problem: Problem, truth: Numbers) -> Fit:
    start = problem.library.hypothesis(tuple(truth))
    known = {
        # What a plant has no number for begins at neutral.
        (c.effect, c.parameter.name): float(
            c.parameter.coordinate(truth[c.effect].get(c.parameter.name, c.parameter.value))
        )
        for c in start.coordinates
        if c.effect
    }
    return fitted(problem, [problem.library.at(tuple(truth), known)], ITERATIONS)[0]


def _others(problem: Problem, null: Fit, truth: Fit, most: int) -> Sequence[Hypothesis]:
    """The other single effects that are most promising, where each begins."""
    promising = screened(problem, null, most + 1)
    return [start for start in promising if start.effects != truth.effects][:most]


def _fewer(problem: Problem, truth: Fit) -> list[Hypothesis]:
    """The truth without each of its effects."""
    return [
        problem.library.at([e for e in truth.effects if e != left_out], truth.named())
        for left_out in truth.effects
    ]


def _measured(
    problem: Problem, null: Fit, truth: Fit | None, repaired: Path
) -> dict[str, dict[str, float]]:
    """Errors of 1 s rollouts on sealed recordings, all by one clock: the oracle's.

    With a baseline the simulation has the correction of what was wrong before the change, as the
    repaired simulator has: closing that is no merit of a name.

    Returns:
        as_given, oracle and named -> `error`, the root mean square standardised residual, and
        `position`, the root mean square distance [m]; both means over segments.
    """
    simulation, segments, library = problem.simulation, problem.segments, problem.library
    noise, clock = noise_model(simulation, segments), (truth or null).vector[-1:]
    settings = library.settings([(library.hypothesis(()), clock)])
    residuals = {"as_given": simulation.residuals(segments, settings)}
    if truth is not None:
        rows = library.settings([(truth, truth.vector)])
        residuals["oracle"] = simulation.residuals(segments, rows)
    if repaired.exists():
        residuals["named"] = Simulation(Maker(str(repaired))).residuals(segments, settings)
    return {
        name: {
            "error": float(noise.whiten(residual)[0].square().mean(-1).sqrt().mean()),
            "position": float(residual[0, ..., :2].square().sum(-1).mean(-1).sqrt().nanmean()),
        }
        for name, residual in residuals.items()
    }


def _cut(folder: Path, most: int, columns: ColumnMap | None) -> Segments:
    """Segments of the recordings in a folder, at most so many.

    Raises:
        ValueError: The reader refuses all of them, as where a sensor contradicts itself.
    """
    recordings, refusals = load_recordings([str(folder)], columns)
    if not recordings:
        raise ValueError(f"no recording in {folder} can be read: {'; '.join(map(str, refusals))}")
    return cut_segments(recordings, SECONDS, SECONDS).spread(most)
