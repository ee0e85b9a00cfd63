"""The answer: what is said of what the search found, and what speaks for it."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from torch import Tensor

from buggy_rl.diagnosis import plausibility
from buggy_rl.diagnosis.answer import Alternative, Answer, Proof, Verdict
from buggy_rl.diagnosis.behaviour import behaviours
from buggy_rl.diagnosis.candidate import excess_misfit
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.confidence import Confidence, confidences
from buggy_rl.diagnosis.delivery import OTHER, Repair, as_file, candidates, chosen
from buggy_rl.diagnosis.equivalents import Equivalents, alike, probability_of_any, swapped
from buggy_rl.diagnosis.excitation import weak
from buggy_rl.diagnosis.experiments import (
    SUGGESTED,
    SURE,
    DecisionRate,
    decision_rates,
    suggestions,
)
from buggy_rl.diagnosis.form_fault import form_faults
from buggy_rl.diagnosis.limits import words_of
from buggy_rl.diagnosis.localisation import locate
from buggy_rl.diagnosis.named_effect import NORMAL, NamedEffect, Value, sentence
from buggy_rl.diagnosis.plausibility import latencies_refused
from buggy_rl.diagnosis.posterior import EVEN, LISTED, shipped
from buggy_rl.diagnosis.proof import SAID
from buggy_rl.diagnosis.retuning import Retuned, with_own
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.diagnosis.unexplained import Unexplained, unexplained
from buggy_rl.diagnosis.validation import ITERATIONS, Errors, delivered, folds, validated
from buggy_rl.diagnosis.verdict import verdict_of
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import OWN, Hypothesis
from buggy_rl.estimation.misfit import misfit
from buggy_rl.vehicle import VehicleDimensions

WRITTEN = 24  # hypotheses that are written down


@dataclass(frozen=True)
class Judged:
    """What is named, how surely, and what kind of answer that is."""

    named: list[NamedEffect]
    verdict: Verdict
    rest: Unexplained


def answered(
    case: Case,
    found: SearchResult,
    progress: Callable[[str], None] = lambda _: None,
    tuned: Retuned | None = None,
) -> Answer:
    """The answer, with what speaks for it.

    Args:
        case: Recordings and simulator, with the noise model that the search came to.
        found: What it found.
        progress: Told what is being done.
        tuned: The simulator's own parameters, where it was re-tuned first.
    """
    problem = case.problem
    progress("locating the error")
    located = locate(case.given, problem.segments, problem.noise.sd, case.names)
    said = judged(case, found, tuned.wrong if tuned else ())
    progress("step tests of both simulators")
    behaved = behaviours(case, found, tuned)
    progress("proving it on what was held out")
    proof, repair = _proof(case, found)
    progress("looking for what to drive next")
    rates = decision_rates(problem, found)
    return Answer(
        verdict=said.verdict,
        located=located,
        effects=said.named,
        remaining=said.rest,
        proof=proof,
        repair=repair,
        weak=weak(problem.segments),
        suggest=suggestions(rates),
        tried=_tried(found),
        posterior=found.posterior,
        manoeuvres=rates,
        equivalents=_equivalents(case, found, said.named, rates),
        behaviours=behaved,
        form=form_faults(problem, found),
    )


def judged(case: Case, found: SearchResult, wrong: Sequence[NamedEffect] = ()) -> Judged:
    """What is named, without proof of it; `wrong`: parameters that were re-tuned."""
    problem, criteria = case.problem, case.criteria
    before, after = _as_given(case, found), found.best.fit.whitened
    share = criteria.rules.depends_share
    rest = unexplained(problem, before, after, share, criteria.usual)
    sure = confidences(found, found.posterior)
    refused = latencies_refused(found.best.fit.values()[""]["clock_offset"])
    named = [_named(case, found, e, sure[e]) for e in found.best.effects if e not in refused]
    named += _retuned(found, before.square().mean(-1), wrong)
    named = sorted((n for n in named if n.confidence >= LISTED), key=lambda n: -n.confidence)
    return Judged(named, verdict_of(found.posterior, named, problem.library.own), rest)


def _as_given(case: Case, found: SearchResult) -> Tensor:
    """Whitened residuals [N, D] of the simulator as it was given."""
    if case.retuned_from is None:
        return found.null.fit.whitened
    return case.problem.noise.whiten(case.given.residuals(case.problem.segments))[0]


def _equivalents(
    case: Case,
    found: SearchResult,
    named: Sequence[NamedEffect],
    rates: Sequence[DecisionRate],
) -> list[Equivalents]:
    """Named effects that are not sure, with what these recordings cannot tell from them."""
    result, least = [], case.criteria.rules.deciding_nats
    best = rates[0] if rates and rates[0].rate >= SUGGESTED else None
    for effect in named:
        if effect.name not in found.best.effects or effect.confidence >= SURE:
            continue
        others = alike(found, effect.name, least)
        if not others:
            continue
        every = (effect.name, *others)
        shares = found.posterior.in_place_of(effect.name)
        finding = Equivalents(
            effects=every,
            probability=probability_of_any(found, every),
            shares=(effect.confidence, *(shares[other] for other in others)),
            nats=max(others.values()),
            sentences=(effect.sentence, *(_words(case, found, effect.name, o) for o in others)),
            decided_by=best.words if best else "",
        )
        result.append(finding)
    return result


def _words(case: Case, found: SearchResult, effect: str, other: str) -> str:
    """Another effect in the place of one of the best hypothesis, in words."""
    candidate, p = swapped(found, effect, other), case.problem.library.numbers(other)[0]
    assert candidate is not None
    values, command = candidate.fit.values()[other], case.recordings[0].command
    return sentence(other, values, p.unit, p.value, command, _car(case, other))


def _car(case: Case, effect: str) -> VehicleDimensions:
    """Dimensions that an effect has been told of; where it has not, the buggy's."""
    own = case.problem.simulation.options.get(effect, {})
    return VehicleDimensions(**own.get("dimensions", {}))


def _named(case: Case, found: SearchResult, effect: str, sure: Confidence) -> NamedEffect:
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
    doubtful = plausibility.implausible(library.numbers(effect), numbers)
    most = EVEN if doubtful and case.criteria.baseline is None else 1.0
    return NamedEffect(
        name=effect,
        kind=kind,
        equation="" if own else effect_class(effect).equation,
        sentence=sentence(
            effect, numbers, p.unit, p.value, case.recordings[0].command, _car(case, effect)
        )
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


def _tried(found: SearchResult) -> list[Alternative]:
    own = found.loss(found.best)
    alternatives = [
        Alternative(
            effects,
            found.loss(c) - own,
            excess_misfit(c, found.null),
            found.log_evidence.get(effects),
        )
        for effects, c in found.tried.items()
    ]
    return sorted(alternatives, key=lambda a: a.nats)[:WRITTEN]


def _retuned(found: SearchResult, given: Tensor, wrong: Sequence[NamedEffect]) -> list[NamedEffect]:
    """Parameters that were off, with what all of them close together.

    As sure as it is that nothing without a name is missing beside them.
    """
    left = found.null.fit.whitened.square().mean(-1)
    first, last = (misfit(square, given) - 1 for square in (given, left))
    gain = max(0.0, first - last) / max(first, 1e-9)
    known = 1.0 - found.posterior.unknown
    return [replace(n, held_out_gain=gain, confidence=n.confidence * known) for n in wrong]


def _proof(case: Case, found: SearchResult) -> tuple[Proof, Repair]:
    """What speaks for the repair on what was held out, and the repair as it is delivered."""
    problem, every = case.problem, [c.fit for c in candidates(found)]
    if case.retuned_from is not None:
        # Its parameters have seen all recordings: they are fitted anew with the effects', from the
        # simulator as given, on what is not held out.
        simulation = replace(problem.simulation, make=case.given.make)
        problem = replace(problem, simulation=simulation)
        every = [with_own(case, fit) for fit in every]
    problem = replace(problem, library=case.as_given, dispersion=1.0)
    starts: dict[str, Hypothesis] = dict(zip(("after", OTHER), every, strict=False))
    second = {name: fit for name, fit in starts.items() if name != "after"}
    errors = validated(problem, every[0], case.recordings, case.budget, second)
    name = chosen(errors, found.posterior.says == "unknown")
    given = errors["before"].square
    if name == "before":
        ways = tuple(errors[n].median.get(SAID) for n in ("before", "after"))
        worse = None if None in ways else ways
        repair = Repair(refused=every[0].effects, worse=worse)  # type: ignore[arg-type]
    else:
        iterations = min(ITERATIONS, case.budget.iterations)
        repair = as_file(*delivered(problem, starts[name], iterations))
    floor = 2 * float(problem.noise.sd[:2].square().sum())
    errors["after"] = errors[name]
    errors.pop(OTHER, None)
    before, none = errors["before"].mean_square, Errors()
    medians = {name: e.median for name, e in errors.items()}
    proof = Proof(
        before=before,
        after=errors["after"].mean_square,
        retuned=errors.get("retuned", none).mean_square,
        noise_floor={h: floor for h in before},
        black_box=errors["black_box"].mean_square,
        median=medians,
        misfit_before=misfit(given, given),
        misfit_after=misfit(errors["after"].square, given),
        held_out=len(folds(problem.segments).unique()) > 1,
    )
    return proof, repair
