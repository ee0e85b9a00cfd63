"""The answer, section by section: what is said of what the search found, and what speaks for it."""

from collections.abc import Callable, Mapping
from typing import Any

from buggy_rl.diagnosis.answer import Alternative, Answer
from buggy_rl.diagnosis.behaviour import behaviours
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.equivalents import equivalents
from buggy_rl.diagnosis.excitation import weak
from buggy_rl.diagnosis.experiments import decision_rates, suggestions
from buggy_rl.diagnosis.form_fault import form_faults
from buggy_rl.diagnosis.localisation import locate
from buggy_rl.diagnosis.proving import proven
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.diagnosis.statement import judged

Part = Mapping[str, Any]
"""Field of `Answer` -> what it holds."""


def answered(
    case: Case, found: SearchResult, progress: Callable[[str], None] = lambda _: None
) -> Answer:
    """The answer, with what speaks for it.

    Args:
        case: Recordings and simulator, with the noise model that the search came to.
        found: What it found.
        progress: Told what is being done.
    """
    parts: dict[str, Any] = {}
    for doing, section in SECTIONS:
        if doing:
            progress(doing)
        parts |= section(case, found)
    same = equivalents(case, found, parts["effects"], parts["manoeuvres"])
    return Answer(**parts, equivalents=same)


def _located(case: Case, found: SearchResult) -> Part:
    del found
    problem = case.problem
    return {"located": locate(case.given, problem.segments, problem.noise.sd, case.names)}


def _named(case: Case, found: SearchResult) -> Part:
    said = judged(case, found)
    return {"effects": said.named, "verdict": said.verdict, "remaining": said.rest}


def _behaves(case: Case, found: SearchResult) -> Part:
    return {"behaviours": behaviours(case, found)}


def _proved(case: Case, found: SearchResult) -> Part:
    shown = proven(case, found)
    return {"proof": shown.proof, "repair": shown.repair}


def _next(case: Case, found: SearchResult) -> Part:
    rates = decision_rates(case.problem, found)
    return {"manoeuvres": rates, "suggest": suggestions(rates), "weak": weak(case.problem.segments)}


def _looked_at(case: Case, found: SearchResult) -> Part:
    return {
        "tried": Alternative.closest(found),
        "posterior": found.posterior,
        "form": form_faults(case.problem, found),
    }


Section = Callable[[Case, SearchResult], Part]
SECTIONS: tuple[tuple[str, Section], ...] = (  # what is told to be done, and what does it
    ("locating the error", _located),
    ("", _named),
    ("step tests of both simulators", _behaves),
    ("proving it on what was held out", _proved),
    ("looking for what to drive next", _next),
    ("", _looked_at),
)
