"""What is named of what a search found, how surely, and what kind of answer that is."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from torch import Tensor

from buggy_rl.diagnosis.answer.answer import Alternative, Verdict
from buggy_rl.diagnosis.answer.named_effect import (
    Confidence,
    NamedEffect,
    check_clock,
    check_latency,
    latencies_refused,
    name_effect,
)
from buggy_rl.diagnosis.answer.retuning import wrong_parameters
from buggy_rl.diagnosis.residuals import unexplained
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.posterior import EVEN, LISTED, Posterior
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.evidence import misfit


def answer_section(case: DiagnosisCase, found: SearchResult) -> Mapping[str, Any]:
    """The part of the answer that says what is named, how surely, and what else was tried."""
    problem, criteria = case.problem, case.criteria
    before, after = _as_given(case, found), found.best.fit.whitened
    share = criteria.rules.depends_share
    rest = unexplained(problem, before, after, share, criteria.usual)
    sure = confidences(found, found.posterior)
    offset = found.best.fit.values()[""]["clock_offset"]
    refused = latencies_refused(offset)
    notes = [*check_clock(offset), *check_latency(found.best.effects, offset)]
    named = [name_effect(case, found, e, sure[e]) for e in found.best.effects if e not in refused]
    if case.tuned is not None:
        wrong = wrong_parameters(case.tuned, criteria.rules, case.given.make(1))
        named += _retuned(found, before.square().mean(-1), wrong)
    named = sorted((n for n in named if n.confidence >= LISTED), key=lambda n: -n.confidence)
    return {
        "effects": named,
        "verdict": verdict_of(found.posterior, named, problem.library.own),
        "remaining": rest,
        "tried": Alternative.closest(found),
        "posterior": found.posterior,
        "notes": notes,
    }


def confidences(found: SearchResult, posterior: Posterior) -> dict[str, Confidence]:
    """Confidence in each effect of the best hypothesis, by the posterior of all sets."""
    result = {}
    for effect in found.best.effects:
        others = posterior.in_place_of(effect)
        listed = {other: p for other, p in others.items() if p >= LISTED}
        result[effect] = Confidence(
            min(1.0, posterior.of(effect)), listed, min(1.0, posterior.whatever_else(effect))
        )
    return result


def verdict_of(posterior: Posterior, named: Sequence[NamedEffect], own: bool = False) -> Verdict:
    """The verdict by what is most probable.

    Args:
        posterior: Of what was fitted.
        named: Effects that are named, the most probable first.
        own: Whether the simulator's own parameters may be what is wrong: then effects that they
            realise are wrong parameters. Where baseline recordings show that they were right, what
            has changed since is physics.
    """
    if posterior.says != "effects":
        return "no_mismatch" if posterior.says == "nothing" else "unknown_physics"
    if not named or named[0].confidence < EVEN:
        return "cannot_tell"
    if all(n.kind == "parameter" or (own and n.inside) for n in named):
        return "wrong_parameters"
    return "missing_physics"


def _as_given(case: DiagnosisCase, found: SearchResult) -> Tensor:
    """Whitened residuals [N, D] of the simulator as it was given."""
    if case.retuned_from is None:
        return found.null.fit.whitened
    return case.problem.noise.whiten(case.given.residuals(case.problem.segments))[0]


def _retuned(found: SearchResult, given: Tensor, wrong: Sequence[NamedEffect]) -> list[NamedEffect]:
    """Parameters that were off, with what all of them close together.

    As sure as it is that nothing without a name is missing beside them.
    """
    left = found.null.fit.whitened.square().mean(-1)
    first, last = (misfit(square, given) - 1 for square in (given, left))
    gain = max(0.0, first - last) / max(first, 1e-9)
    known = 1.0 - found.posterior.unknown
    return [replace(n, held_out_gain=gain, confidence=n.confidence * known) for n in wrong]
