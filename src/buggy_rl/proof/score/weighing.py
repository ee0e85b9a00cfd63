"""What is written of a case once its answer is there: what could be known, what came of it.

Beside the oracle's fits: the strength of each effect, the terms that are what was composed, and the
distances of the repaired simulator on the sealed drives.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from buggy_rl.core.files import write_json
from buggy_rl.diagnosis.run.case import segments_of
from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.estimation.gauss_newton import fitted
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.rollout import AS_GIVEN, Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.proof.baselines.asked import Asked, open_question
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.score.answers import WeighedAnswer
from buggy_rl.proof.score.held_out import Rolled, median_distance, stack_errors
from buggy_rl.proof.score.oracle import (
    ITERATIONS,
    Numbers,
    TrueFits,
    described,
    sealed_errors,
    true_fits,
    true_numbers,
)
from buggy_rl.proof.score.outcome import ScoredCase
from buggy_rl.proof.score.stack import StackErrors
from buggy_rl.proof.score.strength import strengths
from buggy_rl.proof.score.terms import TermMatch, in_grammar, matches
from buggy_rl.recordings import load_recordings

CLOSEST = 10  # terms that are kept of a case


def weigh(store: CaseStore, case: Case, effects: Sequence[str] = (), rivals: int = 6) -> int:
    """Fits the truth to a case's drives, measures all on those held out, and writes it down.

    Of `effects`, empty for the whole library, the `rivals` most promising other ones are fitted
    too. Returns 1, the number of cases.
    """
    try:
        asked = open_question(store.inputs(case.id))
        weights = _weights(asked, case, effects, rivals)
        fits, aside = weights.fits, _sealed(store, case, asked)
        named = fits if fits is not None and described(case) else None
        result = weights.told | ({} if named is None else named.costs)
        result["held_out"] = _errors(store, case, asked, named, aside)
        result["stack"] = _stack(store, case, asked, aside)
    except (ValueError, RuntimeError) as error:  # a plant that spins, a drive in too many pieces
        result = {"failed": store.told(error)}
    write_json(store.oracle(case.id), result)
    return 1


def shown(store: CaseStore, case: Case, rivals: int) -> dict[str, Any]:
    """How strongly what is concealed shows, and which terms it is.

    Args:
        store: Of the case; only what the diagnosis is given is read.
        case: With what is concealed.
        rivals: Other effects that are fitted.
    """
    return _weights(open_question(store.inputs(case.id)), case, (), rivals).told


@dataclass(frozen=True, eq=False)
class _Weights:
    """What a truth is fitted by; None for what neither effects nor terms describe."""

    fits: TrueFits | None
    told: dict[str, Any]


def _weights(asked: Asked, case: Case, effects: Sequence[str], rivals: int) -> _Weights:
    found = _terms(asked, case)
    true: Numbers = true_numbers(case) if described(case) else {}
    if (term := in_grammar(found)) is not None:
        true = {term.name: {"coefficient": term.coefficient}}
    kept = [m for place, m in enumerate(found.values()) if place < CLOSEST or m.right]
    told: dict[str, Any] = {"strength": {}, "terms": [asdict(match) for match in kept]}
    if not true:
        return _Weights(None, told)
    problem = asked.ready.problem
    if effects:
        problem = replace(problem, library=Library(list(effects)))
    fits = true_fits(problem, true, rivals)
    told["strength"] = strengths(fits, asked.ready.criteria.group)["strength"]
    return _Weights(fits, told)


def answer_of(scored: ScoredCase, weights: Mapping[str, Any]) -> WeighedAnswer:
    """An answer beside what was written of its case."""
    terms = [TermMatch(**match) for match in weights.get("terms", ())]
    stack = weights.get("stack")
    return WeighedAnswer(
        scored,
        strength=dict(weights.get("strength", {})),
        terms={match.name: match for match in terms},
        stack=None if stack is None else StackErrors.from_dict(stack),
    )


def _terms(asked: Asked, case: Case) -> dict[str, TermMatch]:
    if not case.disturbances:
        return {}
    drives = [recording.data for recording in asked.recordings]
    return matches(case.disturbances[0], drives)


def _sealed(store: CaseStore, case: Case, asked: Asked) -> Segments:
    """Segments of the sealed drives.

    Raises:
        ValueError: A drive is refused.
    """
    config = asked.config
    drives, refusals = load_recordings(
        [str(store.held_out(case.id))], config.columns or None, config.dt, car=config.car
    )
    if refusals:
        raise ValueError("; ".join(map(str, refusals)))
    return segments_of(drives, config)


def _errors(
    store: CaseStore, case: Case, asked: Asked, fits: TrueFits | None, aside: Segments
) -> dict[str, dict[str, float]]:
    """Errors on the sealed drives; `fits` of what has a name in the library, None of others."""
    file = store.diagnosis(case.id) / "repaired.yaml"
    if fits is not None:
        return sealed_errors(replace(fits.problem, segments=aside), fits.null, fits.truth, file)
    problem = asked.ready.problem
    [null] = fitted(problem, [problem.library.hypothesis(())], ITERATIONS)
    return sealed_errors(replace(problem, segments=aside), null, None, file)


def _stack(store: CaseStore, case: Case, asked: Asked, aside: Segments) -> dict[str, Any]:
    """Distances on the sealed drives of what was delivered, and of what is simpler."""
    rolled = _delivered(asked, store.diagnosis(case.id) / "repaired.yaml")
    return asdict(stack_errors(asked.ready, rolled, aside))


def _delivered(asked: Asked, file: Path) -> Rolled:
    """Simulator of a file, or the one as given where there is none."""
    if not file.exists():
        return asked.ready.given, AS_GIVEN
    make = Maker(str(file))
    return Simulation(make, options=measurable_options(make)[0]), AS_GIVEN


def sealed_distance(store: CaseStore, case: Case, file: Path) -> float:
    """Median distance [m] after 1 s, on the sealed drives, of a repaired simulator.

    Args:
        store: Of the case.
        case: With what is concealed.
        file: `repaired.yaml`; where there is none, it is the simulator as given.
    """
    asked = open_question(store.inputs(case.id))
    return median_distance(_delivered(asked, file), _sealed(store, case, asked))
