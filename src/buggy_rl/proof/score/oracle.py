"""What could be known of a case: its true structure, fitted to the drives that the tool had."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.effects import offered
from buggy_rl.estimation.gauss_newton import Fit, Problem, fitted
from buggy_rl.estimation.hypothesis import Hypothesis
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.sparse import screened
from buggy_rl.proof.cases.case import Case, Concealing
from buggy_rl.proof.cases.equivalents import expected, meant

ITERATIONS = 8  # of a fit
JOINED = "+"
MORE = 6  # promising ones looked at beyond those wanted: some are the truth by another name


def described(case: Case) -> bool:
    """Whether effects describe what is concealed, and something is."""
    return bool(case.truth) and set(case.truth) <= set(offered(case.longitudinal))


Numbers = Mapping[str, Mapping[str, float]]
"""Effect -> parameter -> value."""


def true_numbers(case: Concealing) -> dict[str, dict[str, float]]:
    """What is concealed in a case, by the numbers that a right answer has."""
    return {effect: expected(case, effect) for effect in case.truth}


@dataclass(frozen=True, eq=False)
class TrueFits:
    """The true structure beside others, all fitted to what the diagnosis searches."""

    problem: Problem
    """What the diagnosis searches, with the dispersion that the truth expects."""
    null: Fit
    truth: Fit
    others: Mapping[str, Fit]
    """Sets without an effect of the truth: the rest of it, alone and with a promising other one."""

    @property
    def costs(self) -> dict[str, Any]:
        """Costs beside the truth's [nats], and its numbers."""
        own = self.problem.cost(self.truth)
        return {
            "temper": self.problem.dispersion,
            "nats": self.problem.cost(self.null) - own,
            "parameters": {e: v for e, v in self.truth.values().items() if e},
            "rivals": {name: self.problem.cost(fit) - own for name, fit in self.others.items()},
        }


def true_fits(problem: Problem, true: Numbers, rivals: int) -> TrueFits:
    """Fits the truth, from its numbers on, nothing, and the sets without each of its effects.

    Args:
        problem: What the diagnosis searches.
        true: What is concealed: effects of the library, or terms.
        rivals: Promising other effects that are fitted.
    """
    first = _truth(problem, true)
    # The truth's own misfit is the dispersion that is expected.
    dispersion = max(1.0, float(first.square.median()) / problem.noise.dimension)
    problem = replace(problem, dispersion=dispersion)
    truth, null = fitted(problem, [first, problem.library.hypothesis(())], ITERATIONS)
    sets = _without_each(problem, null, truth, rivals)
    found = fitted(problem, list(sets.values()), ITERATIONS)
    return TrueFits(problem, null, truth, dict(zip(sets, found, strict=True)))


def _truth(problem: Problem, truth: Numbers) -> Fit:
    return fitted(problem, [at_true_numbers(problem, truth)], ITERATIONS)[0]


def at_true_numbers(problem: Problem, truth: Numbers) -> Hypothesis:
    """The true structure at the numbers that are concealed, where a fit of it begins."""
    start = problem.library.hypothesis(tuple(truth))
    known = {
        # What a plant has no number for begins at neutral.
        (c.effect, c.parameter.name): float(
            c.parameter.coordinate(truth[c.effect].get(c.parameter.name, c.parameter.value))
        )
        for c in start.coordinates
        if c.effect
    }
    return problem.library.at(tuple(truth), known)


def _without_each(problem: Problem, null: Fit, truth: Fit, rivals: int) -> dict[str, Hypothesis]:
    """Sets without each effect of the truth: the rest, alone and with each other effect."""
    others = [
        start
        for start in screened(problem, null, rivals + MORE)
        if meant(start.effects[-1]) not in truth.effects
    ][:rivals]
    found: dict[str, Hypothesis] = {}
    for left_out in truth.effects:
        rest = [effect for effect in truth.effects if effect != left_out]
        sets = [problem.library.at(rest, truth.named())] if rest else []
        sets += [
            problem.library.at([*rest, *start.effects], {**truth.named(), **start.named()})
            for start in others
        ]
        found |= {JOINED.join(start.effects): start for start in sets}
    return found


def sealed_errors(
    problem: Problem, null: Fit, truth: Fit | None, repaired: Path
) -> dict[str, dict[str, float]]:
    """Errors of 1 s rollouts on sealed recordings, all by one clock: the oracle's.

    With a baseline the simulation has the correction of what was wrong before the change, as the
    repaired simulator has: closing that is no merit of a name.

    Args:
        problem: On segments of the sealed recordings.
        null: Fit of nothing to the drives that the tool had.
        truth: Fit of the truth to them; None for what has no name.
        repaired: File of the repaired simulator, or none.

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
