"""What is said of what was found."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from torch import Tensor

from buggy_rl.diagnosis.answer import NORMAL, Answer, Named, Proof, Tried, Value, sentence
from buggy_rl.diagnosis.candidate import size
from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.confidence import Confidence, confidences, soundness
from buggy_rl.diagnosis.constancy import varying
from buggy_rl.diagnosis.excitation import weak
from buggy_rl.diagnosis.experiments import suggestions
from buggy_rl.diagnosis.localisation import locate
from buggy_rl.diagnosis.retuning import with_own
from buggy_rl.diagnosis.search import Found, Search
from buggy_rl.diagnosis.unexplained import remaining
from buggy_rl.diagnosis.validation import Errors, folds, prove
from buggy_rl.diagnosis.verdict import verdict_of
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import OWN
from buggy_rl.estimation.misfit import NOTHING, misfit

TOLD = 24  # explanations that are written down
MOST_RIVALS = 4  # that a manoeuvre is looked for to decide between


def stated(
    case: Case,
    search: Search,
    found: Found,
    progress: Callable[[str], None] = lambda _: None,
    wrong: Sequence[Named] = (),
) -> Answer:
    """The answer, with what speaks for it.

    Args:
        case: Drives and simulator.
        search: That has come to what was found.
        found: What it found.
        progress: Told in plain words what is being done.
        wrong: Parameters that the simulator was re-tuned by.
    """
    progress("locating the error")
    located = locate(case.given, case.cut, case.likelihood.noise, case.names)
    instants = case.player.instants(case.cut)
    before = found.null.fitted.white
    if case.retuned_from is not None:
        before = case.likelihood.white(case.given.play(case.cut, {}))[0]
    rest = remaining(case.cut, instants, before, found.best.fitted.white, case.usual)
    given = before.square().mean(-1)
    first = misfit(given, given) - 1
    closed = {c: found.closed(c) / max(first, 1e-9) for c in found.best.causes}
    varies = {c: varying(search.fitter, found.best, found.null, search.group, c) for c in closed}
    at_end = {c for c in closed if case.library.deciding(c) <= {*found.best.fitted.at_bound(c)}}
    sure = confidences(search, found, closed, rest.unclosed, varies, at_end)
    progress("proving it on what was held out")
    proof = _proof(case, found, given)
    named = [_named(case, found, c, sure[c]) for c in found.best.causes]
    named += _retuned(found, given, wrong, rest.unclosed)
    named.sort(key=lambda n: -n.held_out_gain)
    verdict = verdict_of(size(found.null, found.null), rest, named, case.usual)
    undecided = []
    for item in named:
        for rival in item.confused_with:
            others = tuple(sorted({*found.best.causes} - {item.name} | {rival}))
            if others in found.tried:
                undecided.append(found.tried[others])
    progress("looking for what to drive next")
    suggest = suggestions(search.fitter, found.best, undecided[:MOST_RIVALS])
    tried = _tried(search, found)
    return Answer(verdict, located, named, rest, proof, weak(case.cut), suggest, tried)


def _named(case: Case, found: Found, cause: str, sure: Confidence) -> Named:
    fitted = found.best.fitted
    by_chance = found.best.evidence.covariance.diagonal().clamp_min(0.0)
    spread = (by_chance + (_mistaken(case, found, cause) * fitted.place).square()).sqrt()
    values: dict[str, Value] = {}
    for unknown, z, sd in zip(fitted.unknowns, fitted.place.tolist(), spread.tolist(), strict=True):
        if unknown.cause != cause:
            continue
        p = unknown.parameter
        values[p.name] = Value(float(p.value_at(z)), *interval(p, z, sd), p.unit)
    numbers = {name: v.value for name, v in values.items()}
    own = cause.startswith(OWN)
    kind = "parameter" if own else effect_class(cause).kind
    p = case.library.numbers(cause)[0]
    return Named(
        name=cause,
        kind=kind,
        equation="" if own else effect_class(cause).equation,
        sentence=sentence(cause, numbers, p.unit, p.value),
        parameters=values,
        confidence=sure.sure,
        held_out_gain=found.closed(cause) / max(found.without(cause), 1e-9),
        confused_with=sure.rivals,
        at_bound=fitted.at_bound(cause),
        varies_with=sure.varies,
    )


def interval(parameter: EffectParameter, place: float, sd: float) -> tuple[float, float]:
    """Bounds of a number's 95 % interval, neither beyond the parameter's own.

    A rate's would turn over there: what is as little as no limit at all has no upper bound.

    Args:
        parameter: The number's.
        place: Its coordinate,
        sd: and standard deviation.
    """
    first, last = sorted(parameter.coordinate(b) for b in (parameter.lower, parameter.upper))
    reached = (min(max(place + side * NORMAL * sd, first), last) for side in (-1, 1))
    low, high = sorted(parameter.value_at(end) for end in reached)
    return float(low), float(high)


def _tried(search: Search, found: Found) -> list[Tried]:
    own = search.loss(found.best)
    weighed = [
        Tried(causes, search.loss(candidate) - own, size(candidate, found.null))
        for causes, candidate in found.tried.items()
    ]
    return sorted(weighed, key=lambda t: t.nats)[:TOLD]


def _mistaken(case: Case, found: Found, cause: str) -> float:
    """Share by which a cause's numbers may be off because an equation is not the car's own.

    If all that remains beyond the usual, and what drives differ by themselves, were more of this
    cause, or less, its numbers would be off by that over what the cause closes: it counts as one
    standard deviation (taken as two, 86 % of 92 intervals of development cases held the truth).
    """
    rest = max(0.0, size(found.best, found.null) - case.usual.mean) + 2 * case.usual.error
    return min(1.0, max(rest, NOTHING) / max(found.closed(cause), 1e-9))


def _retuned(found: Found, given: Tensor, wrong: Sequence[Named], remains: float) -> list[Named]:
    """Parameters that were off, with what all of them close together."""
    left = found.null.fitted.white.square().mean(-1)
    first, last = (misfit(square, given) - 1 for square in (given, left))
    gain = max(0.0, first - last) / max(first, 1e-9)
    sound = soundness(gain, remains)
    return [replace(n, held_out_gain=gain, confidence=n.confidence * sound) for n in wrong]


def _proof(case: Case, found: Found, given: Tensor) -> Proof:
    player, best = case.player, found.best.fitted
    if case.retuned_from is not None:
        # Its numbers have seen all drives: they are fitted anew with the causes', from the
        # simulator as given, on what is not held out.
        player, best = replace(player, make=case.given.make), with_own(case, best)
    errors = prove(player, case.recordings, case.cut, case.likelihood, case.as_given, best)
    floor = 2 * float(case.likelihood.noise[:2].square().sum())
    before, none = errors["before"].mean_square, Errors()
    return Proof(
        before=before,
        after=errors["after"].mean_square,
        retuned=errors.get("retuned", none).mean_square,
        noise_floor={h: floor for h in before},
        black_box=errors["black_box"].mean_square,
        median={name: e.median for name, e in errors.items()},
        misfit_before=misfit(given, given),
        misfit_after=misfit(errors["after"].white, given),
        held_out=len(folds(case.cut).unique()) > 1,
    )
