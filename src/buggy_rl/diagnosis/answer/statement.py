"""What is named of what a search found, how surely, and what kind of answer that is."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from buggy_rl.diagnosis.answer import named_effect as plausibility
from buggy_rl.diagnosis.answer.answer import Alternative, Verdict
from buggy_rl.diagnosis.answer.named_effect import (
    NamedEffect,
    Value,
    check_clock,
    check_latency,
    latencies_refused,
    sentence,
)
from buggy_rl.diagnosis.answer.retuning import wrong_parameters
from buggy_rl.diagnosis.residuals import unexplained
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.candidate import excess_misfit
from buggy_rl.diagnosis.search.limits import words_of
from buggy_rl.diagnosis.search.posterior import EVEN, LISTED, NORMAL, Posterior, shipped
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.evidence import misfit
from buggy_rl.estimation.hypothesis import OWN


def answer_section(case: DiagnosisCase, found: SearchResult) -> Mapping[str, Any]:
    """The part of the answer that says what is named, how surely, and what else was tried."""
    problem, criteria = case.problem, case.criteria
    before, after = _as_given(case, found), found.best.fit.whitened
    share = criteria.rules.depends_share
    rest = unexplained(problem, before, after, share, criteria.usual)
    sure = confidences(found, found.posterior)
    offset = found.best.fit.values()[""]["clock_offset"]
    refused = latencies_refused(offset)
    named = [_named(case, found, e, sure[e]) for e in found.best.effects if e not in refused]
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
        "notes": [*check_clock(offset), *check_latency(found.best.effects, offset)],
    }


@dataclass(frozen=True)
class Confidence:
    """Of one effect of the best hypothesis."""

    probability: float
    alternatives: dict[str, float]
    """Other effects in its place -> their probability."""
    whatever_else: float
    """Probability if effects are missing at all."""


def confidences(found: SearchResult, posterior: Posterior) -> dict[str, Confidence]:
    """Of each effect of the best hypothesis, by the posterior of all sets."""
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


def _named(case: DiagnosisCase, found: SearchResult, effect: str, sure: Confidence) -> NamedEffect:
    fit, problem = found.best.fit, case.problem
    by_blocks = found.best.cross_validated.covariance.diagonal().clamp_min(0.0)
    excess = excess_misfit(found.best, found.null)
    form, share = shipped().form_error, case.criteria.usual.remaining(excess, found.closed(effect))
    spread = [
        form.sd(z, math.sqrt(v), share)
        for z, v in zip(fit.vector.tolist(), by_blocks.tolist(), strict=True)
    ]
    values: dict[str, Value] = {}
    for c, z, sd in zip(fit.coordinates, fit.vector.tolist(), spread, strict=True):
        if c.effect != effect:
            continue
        p = c.parameter
        values[p.name] = Value(float(p.value_at(z)), *interval(p, z, sd), p.unit)
    numbers = {name: v.value for name, v in values.items()}
    own = effect.startswith(OWN)
    kind = "parameter" if own else effect_class(effect).kind
    library = case.problem.library
    p = library.numbers(effect)[0]
    unusual = plausibility.unusual(library.numbers(effect), numbers)
    # Without a baseline nothing shows that the simulator was right but for this.
    doubtful = plausibility.effect_implausible(library.numbers(effect), numbers)
    most = EVEN if doubtful and case.criteria.baseline is None else 1.0
    return NamedEffect(
        name=effect,
        kind=kind,
        equation="" if own else effect_class(effect).equation,
        sentence=sentence(effect, numbers, p.unit, p.value, case.command, case.car_of(effect))
        + words_of(effect, found.same),
        parameters=values,
        confidence=min(most, sure.probability),
        held_out_gain=found.closed(effect) / max(found.without(effect), 1e-9),
        confused_with=sure.alternatives,
        at_bound=fit.at_bound(effect),
        varies_with=found.varies.get(effect, ""),
        whatever_else=sure.whatever_else,
        inside=(effect.removeprefix(OWN),) if own else library.inside.parameters_of(effect),
        unusual=unusual,
        undetermined=plausibility.undetermined(library.numbers(effect), values, problem.segments),
    )


def interval(parameter: EffectParameter, z: float, sd: float) -> tuple[float, float]:
    """95 % interval of a parameter's value, neither end beyond the parameter's own bounds.

    A reciprocal parameter's would turn over there: a rate limit near none has no upper bound.

    Args:
        parameter: The parameter.
        z: Its coordinate,
        sd: and that coordinate's standard deviation.
    """
    first, last = sorted(parameter.coordinate(b) for b in (parameter.lower, parameter.upper))
    reached = (min(max(z + side * NORMAL * sd, first), last) for side in (-1, 1))
    low, high = sorted(parameter.value_at(end) for end in reached)
    return float(low), float(high)


def _retuned(found: SearchResult, given: Tensor, wrong: Sequence[NamedEffect]) -> list[NamedEffect]:
    """Parameters that were off, with what all of them close together.

    As sure as it is that nothing without a name is missing beside them.
    """
    left = found.null.fit.whitened.square().mean(-1)
    first, last = (misfit(square, given) - 1 for square in (given, left))
    gain = max(0.0, first - last) / max(first, 1e-9)
    known = 1.0 - found.posterior.unknown
    return [replace(n, held_out_gain=gain, confidence=n.confidence * known) for n in wrong]
