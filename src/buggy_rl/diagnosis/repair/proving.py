"""What speaks for a repair on what was held out, and the repair as it is delivered."""

from dataclasses import dataclass, replace

from buggy_rl.diagnosis.answer.retuning import with_own
from buggy_rl.diagnosis.repair.delivery import OTHER, Repair, as_file, chosen, repair_candidates
from buggy_rl.diagnosis.repair.proof import SAID, Proof
from buggy_rl.diagnosis.repair.validation import (
    ITERATIONS,
    Errors,
    delivered,
    segment_folds,
    validated,
)
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.evidence import misfit
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.hypothesis import Hypothesis


@dataclass(frozen=True)
class Proven:
    """A repair and its proof."""

    proof: Proof
    repair: Repair


def proven(case: DiagnosisCase, found: SearchResult) -> Proven:
    """Validates the sets of effects that may be delivered, and delivers one, or none."""
    problem, every = case.problem, [c.fit for c in repair_candidates(found)]
    if case.retuned_from is not None:
        # Its parameters have seen all recordings: they are fitted anew with the effects', from the
        # simulator as given, on what is not held out.
        simulation = replace(problem.simulation, make=case.given.make)
        problem = replace(problem, simulation=simulation)
        every = [with_own(case, fit) for fit in every]
    problem = replace(problem, library=case.as_given, dispersion=1.0)
    starts: dict[str, Hypothesis] = dict(zip(("after", OTHER), every, strict=False))
    second = {name: fit for name, fit in starts.items() if name != "after"}
    errors = validated(problem, every[0], case.drives.longer, case.budget, second)
    name = chosen(errors, found.posterior.says == "unknown")
    if name == "before":
        ways = tuple(errors[n].median.get(SAID) for n in ("before", "after"))
        worse = None if None in ways else ways
        repair = Repair(refused=every[0].effects, worse=worse)  # type: ignore[arg-type]
    else:
        iterations = min(ITERATIONS, case.budget.iterations)
        repair = as_file(*delivered(problem, starts[name], iterations))
    errors["after"] = errors[name]
    errors.pop(OTHER, None)
    return Proven(_proof(problem, errors), repair)


def _proof(problem: Problem, errors: dict[str, Errors]) -> Proof:
    """Errors of rollouts by what they are of, beside the sensor's noise."""
    floor = 2 * float(problem.noise.sd[:2].square().sum())
    before, given, none = errors["before"].mean_square, errors["before"].square, Errors()
    return Proof(
        before=before,
        after=errors["after"].mean_square,
        retuned=errors.get("retuned", none).mean_square,
        noise_floor={h: floor for h in before},
        black_box=errors["black_box"].mean_square,
        median={name: e.median for name, e in errors.items()},
        misfit_before=misfit(given, given),
        misfit_after=misfit(errors["after"].square, given),
        held_out=len(segment_folds(problem.segments).unique()) > 1,
    )
