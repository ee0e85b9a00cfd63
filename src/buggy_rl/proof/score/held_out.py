"""Distances on sealed drives: of a repaired simulator, and of what is simpler, fitted here."""

from collections.abc import Mapping
from dataclasses import replace

from buggy_rl.diagnosis.repair.proof import Repair
from buggy_rl.diagnosis.repair.validation import (
    SAID,
    Errors,
    Validation,
    add_without_fault,
    delivered,
    retunable,
)
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.residual_process import Recipe
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.proof.score.stack import SIMPLER, StackErrors

Rolled = tuple[Simulation, ParameterSets]
"""A simulator with its numbers."""


def stack_errors(
    case: DiagnosisCase,
    stack: Rolled,
    aside: Segments,
    beside: Mapping[str, Hypothesis] | None = None,
) -> StackErrors:
    """Distances of what is delivered and of what is simpler.

    Args:
        case: What was seen; re-tuning and a learned residual are fitted to it here.
        stack: What the diagnosis delivers.
        aside: Segments of drives that nothing was fitted to.
        beside: Further sets to fit about the simulator as given, by name.
    """
    problem = replace(case.problem, simulation=case.given, library=case.as_given, dispersion=1.0)
    nothing, plenty = problem.library.hypothesis(()), case.drives.plenty
    validation = Validation(problem, plenty=plenty)

    def simple(start: Hypothesis, recipe: Recipe | None = None) -> Rolled:
        file = delivered(problem, start, case.budget.iterations, recipe, plenty)
        return Repair(residual=file.residual, fit=file.fit).simulation(case)

    rolled = {
        "as_given": Repair().simulation(case),
        "stack": stack,
        "retuned": simple(problem.library.hypothesis(retunable(problem.library))),
        "residual": simple(nothing, validation.residuals().recipe),
        **{name: simple(start) for name, start in (beside or {}).items()},
    }
    errors = {name: _errors(*each, aside) for name, each in rolled.items()}
    exact = Errors()
    add_without_fault(exact, stack[0], aside, stack[1])
    return StackErrors(
        {name: of.median[SAID] for name, of in errors.items()},
        {name: _farther(errors["stack"], errors[name]) for name in SIMPLER},
        exact.median[SAID],
    )


def median_distance(rolled: Rolled, aside: Segments) -> float:
    """Median distance after 1 s [m] of a simulator on segments."""
    return _errors(*rolled, aside).median[SAID]


def _errors(simulation: Simulation, settings: ParameterSets, aside: Segments) -> Errors:
    errors, instants = Errors(), simulation.instants(aside)
    [found] = simulation.residuals(aside, settings)
    away = found[..., :2].square().sum(-1)
    errors.add(away, instants, aside.dt)
    errors.distance = away[:, instants <= round(SAID / aside.dt)].mean(1).sqrt()
    return errors


def _farther(stack: Errors, other: Errors) -> tuple[float, float]:
    """Mean over segments of the logarithm of one distance over another, and its standard error."""
    ratio = (stack.distance / other.distance).log().double()
    return float(ratio.mean()), float(ratio.std() / len(ratio) ** 0.5)
