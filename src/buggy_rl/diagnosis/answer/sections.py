"""The answer, section by section: what is said of what the search found, and what speaks for it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from buggy_rl.diagnosis.answer.answer import Alternative, Answer
from buggy_rl.diagnosis.answer.behaviour import behaviours, form_faults
from buggy_rl.diagnosis.answer.equivalents import equivalents
from buggy_rl.diagnosis.answer.experiments import decision_rates, manoeuvre_suggestions
from buggy_rl.diagnosis.answer.statement import judged
from buggy_rl.diagnosis.preflight.recordings import weak
from buggy_rl.diagnosis.repair.proving import proven
from buggy_rl.diagnosis.residuals import locate
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.run.plan import Part
from buggy_rl.diagnosis.search.joint import Admits
from buggy_rl.diagnosis.search.result import SearchResult

Parts = Mapping[str, Any]
"""Field of `Answer` -> what it holds."""
Say = Callable[[DiagnosisCase, SearchResult], Parts]


@dataclass(frozen=True)
class Section:
    """A part of the answer."""

    doing: str
    """What is told to be done; empty for what takes no time."""
    say: Say
    part: Part | None = None
    """Part of the plan, which is asked for time."""
    otherwise: Say | None = None
    """What is said where there is no time for it."""
    left_out: str = ""
    """What is left out then, in words."""


def answered(
    case: DiagnosisCase,
    found: SearchResult,
    progress: Callable[[str], None] = lambda _: None,
    admits: Admits = lambda _: True,
) -> Answer:
    """The answer, with what speaks for it.

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
        say = section.say
        if section.part and section.otherwise and not admits(section.part):
            say = section.otherwise
            left_out.append(section.left_out)
        parts |= say(case, found)
    same = equivalents(case, found, parts["effects"], parts["manoeuvres"])
    return Answer(**parts, equivalents=same, left_out=left_out)


def _located(case: DiagnosisCase, found: SearchResult) -> Parts:
    del found
    problem = case.problem
    return {"located": locate(case.given, problem.segments, problem.noise.sd, case.names)}


def _named(case: DiagnosisCase, found: SearchResult) -> Parts:
    said = judged(case, found)
    return {"effects": said.named, "verdict": said.verdict, "remaining": said.rest}


def _behaves(case: DiagnosisCase, found: SearchResult) -> Parts:
    return {"behaviours": behaviours(case, found)}


def _proved(case: DiagnosisCase, found: SearchResult) -> Parts:
    shown = proven(case, found)
    return {"proof": shown.proof, "repair": shown.repair}


def _proved_on_segments(case: DiagnosisCase, found: SearchResult) -> Parts:
    return _proved(replace(case, budget=replace(case.budget, longer=False)), found)


def _next(case: DiagnosisCase, found: SearchResult) -> Parts:
    rates = decision_rates(case.problem, found)
    return {
        "manoeuvres": rates,
        "suggest": manoeuvre_suggestions(rates),
        "weak": weak(case.problem.segments),
    }


def _nothing_next(case: DiagnosisCase, found: SearchResult) -> Parts:
    del found
    return {
        "manoeuvres": [],
        "suggest": manoeuvre_suggestions([]),
        "weak": weak(case.problem.segments),
    }


def _looked_at(case: DiagnosisCase, found: SearchResult) -> Parts:
    return {
        "tried": Alternative.closest(found),
        "posterior": found.posterior,
        "form": form_faults(case.problem, found),
    }


SECTIONS = (
    Section("locating the error", _located),
    Section("", _named),
    Section("step tests of both simulators", _behaves),
    Section(
        "proving it on what was held out",
        _proved,
        "longer",
        _proved_on_segments,
        "errors beyond the segments",
    ),
    Section(
        "looking for what to drive next", _next, "experiments", _nothing_next, "what to drive next"
    ),
    Section("", _looked_at),
)
