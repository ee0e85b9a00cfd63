"""The answer: what is said of what the search found, and what speaks for it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from torch import Tensor

from buggy_rl.diagnosis.answer import (
    NORMAL,
    Alternative,
    Answer,
    NamedEffect,
    Proof,
    Value,
    Verdict,
    sentence,
)
from buggy_rl.diagnosis.candidate import Candidate, excess_misfit
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.confidence import (
    Confidence,
    Doubts,
    confidences,
    posterior_confidences,
    soundness,
)
from buggy_rl.diagnosis.constancy import variation
from buggy_rl.diagnosis.excitation import weak
from buggy_rl.diagnosis.experiments import suggestions
from buggy_rl.diagnosis.localisation import locate
from buggy_rl.diagnosis.posterior import LISTED
from buggy_rl.diagnosis.retuning import with_own
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.diagnosis.unexplained import Unexplained, unexplained
from buggy_rl.diagnosis.validation import Errors, folds, validated
from buggy_rl.diagnosis.verdict import verdict_by, verdict_of
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import OWN, Hypothesis, Library
from buggy_rl.estimation.misfit import NOTHING, misfit

WRITTEN = 24  # hypotheses that are written down
MOST_ALTERNATIVES = 4  # that a manoeuvre is looked for to decide between


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
    wrong: Sequence[NamedEffect] = (),
) -> Answer:
    """The answer, with what speaks for it.

    Args:
        case: Recordings and simulator, with the noise model that the search came to.
        found: What it found.
        progress: Told what is being done.
        wrong: Parameters that the simulator was re-tuned by.
    """
    problem, rules = case.problem, case.criteria.rules
    progress("locating the error")
    located = locate(case.given, problem.segments, problem.noise.sd, case.names)
    said = judged(case, found, wrong)
    progress("proving it on what was held out")
    proof = _proof(case, found, _as_given(case, found).square().mean(-1))
    progress("looking for what to drive next")
    undecided = _undecided(found, said.named)
    return Answer(
        verdict=said.verdict,
        located=located,
        effects=said.named,
        remaining=said.rest,
        proof=proof,
        weak=weak(problem.segments),
        suggest=suggestions(problem, found.best, undecided, rules.deciding_nats),
        tried=_tried(found),
        posterior=found.posterior,
    )


def judged(case: Case, found: SearchResult, wrong: Sequence[NamedEffect] = ()) -> Judged:
    """What is named, without proof of it; the arguments are those of `answered`."""
    problem, criteria = case.problem, case.criteria
    before, after = _as_given(case, found), found.best.fit.whitened
    share = criteria.rules.depends_share
    rest = unexplained(problem, before, after, share, criteria.usual)
    given = before.square().mean(-1)
    sure = _sure(case, found, given, rest.unclosed)
    named = [_named(case, found, e, sure[e]) for e in found.best.effects]
    named += _retuned(case, found, given, wrong, rest.unclosed)
    named.sort(key=lambda n: -n.held_out_gain)
    if found.posterior is None:
        excess = excess_misfit(found.null, found.null)
        return Judged(named, verdict_of(excess, rest, named, criteria), rest)
    named = sorted((n for n in named if n.confidence >= LISTED), key=lambda n: -n.confidence)
    return Judged(named, verdict_by(found.posterior, named), rest)


def _as_given(case: Case, found: SearchResult) -> Tensor:
    """Whitened residuals [N, D] of the simulator as it was given."""
    if case.retuned_from is None:
        return found.null.fit.whitened
    return case.problem.noise.whiten(case.given.residuals(case.problem.segments))[0]


def _sure(case: Case, found: SearchResult, given: Tensor, unclosed: float) -> dict[str, Confidence]:
    """How sure each effect of the best hypothesis is."""
    if found.posterior is not None:
        return posterior_confidences(found, found.posterior)
    return confidences(found, _doubts(case, found, given, unclosed), case.criteria.rules)


def _doubts(case: Case, found: SearchResult, given: Tensor, unclosed: float) -> Doubts:
    first, fit, problem = misfit(given, given) - 1, found.best.fit, case.problem
    return Doubts(
        closed={e: found.closed(e) / max(first, 1e-9) for e in fit.effects},
        unclosed=unclosed,
        varies={
            e: variation(case.criteria, problem, found.best, found.null, e) for e in fit.effects
        },
        at_bound=decided_at_bound(fit, problem.library),
    )


def decided_at_bound(fit: Hypothesis, library: Library) -> set[str]:
    """Effects of which all the parameters that decide how large they are lie at a bound."""
    return {e for e in fit.effects if library.deciding(e) <= {*fit.at_bound(e)}}


def _undecided(found: SearchResult, named: Sequence[NamedEffect]) -> list[Candidate]:
    """Alternatives that the data do not tell from the best hypothesis, the closest first."""
    undecided = []
    for item in named:
        for other in item.confused_with:
            key = tuple(sorted({*found.best.effects} - {item.name} | {other}))
            if key in found.tried:
                undecided.append(found.tried[key])
    return undecided[:MOST_ALTERNATIVES]


def _named(case: Case, found: SearchResult, effect: str, sure: Confidence) -> NamedEffect:
    fit = found.best.fit
    by_chance = found.best.cross_validated.covariance.diagonal().clamp_min(0.0)
    spread = (by_chance + (_mistaken(case, found, effect) * fit.vector).square()).sqrt()
    values: dict[str, Value] = {}
    for c, z, sd in zip(fit.coordinates, fit.vector.tolist(), spread.tolist(), strict=True):
        if c.effect != effect:
            continue
        p = c.parameter
        values[p.name] = Value(float(p.value_at(z)), *interval(p, z, sd), p.unit)
    numbers = {name: v.value for name, v in values.items()}
    own = effect.startswith(OWN)
    kind = "parameter" if own else effect_class(effect).kind
    p = case.problem.library.numbers(effect)[0]
    return NamedEffect(
        name=effect,
        kind=kind,
        equation="" if own else effect_class(effect).equation,
        sentence=sentence(effect, numbers, p.unit, p.value),
        parameters=values,
        confidence=sure.probability,
        held_out_gain=found.closed(effect) / max(found.without(effect), 1e-9),
        confused_with=sure.alternatives,
        at_bound=fit.at_bound(effect),
        varies_with=sure.varies,
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


def _mistaken(case: Case, found: SearchResult, effect: str) -> float:
    """Share by which an effect's numbers may be off because its equation is not the car's own.

    If all that remains beyond the baseline were more of this effect, or less, its numbers would be
    off by that over what the effect closes: it counts as one standard deviation (taken as two,
    86 % of 92 intervals of development cases held the truth).
    """
    usual = case.criteria.usual
    rest = max(0.0, excess_misfit(found.best, found.null) - usual.mean) + 2 * usual.error
    return min(1.0, max(rest, NOTHING) / max(found.closed(effect), 1e-9))


def _retuned(
    case: Case, found: SearchResult, given: Tensor, wrong: Sequence[NamedEffect], remains: float
) -> list[NamedEffect]:
    """Parameters that were off, with what all of them close together."""
    left = found.null.fit.whitened.square().mean(-1)
    first, last = (misfit(square, given) - 1 for square in (given, left))
    gain = max(0.0, first - last) / max(first, 1e-9)
    sound = soundness(gain, remains, case.criteria.rules)
    return [replace(n, held_out_gain=gain, confidence=n.confidence * sound) for n in wrong]


def _proof(case: Case, found: SearchResult, given: Tensor) -> Proof:
    problem, best = case.problem, found.best.fit
    if case.retuned_from is not None:
        # Its parameters have seen all recordings: they are fitted anew with the effects', from the
        # simulator as given, on what is not held out.
        simulation = replace(problem.simulation, make=case.given.make)
        problem, best = replace(problem, simulation=simulation), with_own(case, best)
    problem = replace(problem, library=case.as_given, dispersion=1.0)
    errors = validated(problem, best, case.recordings)
    floor = 2 * float(problem.noise.sd[:2].square().sum())
    before, none = errors["before"].mean_square, Errors()
    return Proof(
        before=before,
        after=errors["after"].mean_square,
        retuned=errors.get("retuned", none).mean_square,
        noise_floor={h: floor for h in before},
        black_box=errors["black_box"].mean_square,
        median={name: e.median for name, e in errors.items()},
        misfit_before=misfit(given, given),
        misfit_after=misfit(errors["after"].square, given),
        held_out=len(folds(problem.segments).unique()) > 1,
    )
