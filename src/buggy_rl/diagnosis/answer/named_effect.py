"""An effect that a diagnosis names: numbers, confidence, and whether they are plausible."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import torch

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.diagnosis.residuals import CONDITIONS
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.candidate import excess_misfit
from buggy_rl.diagnosis.search.limits import words_of
from buggy_rl.diagnosis.search.posterior import EVEN, NORMAL, certainly_missing, shipped
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.hypothesis import CLOCK, CLOCK_PRIOR, OWN
from buggy_rl.estimation.segments import Segments

SUREST = 0.99  # [-] confidence that is said at most: some hundred cases show no more


@dataclass(frozen=True)
class Value:
    """A fitted number with the bounds of its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class NamedEffect:
    """An effect that the search selected."""

    name: str
    kind: Literal["actuation", "motion", "sensing", "parameter", "term"]
    equation: str
    sentence: str
    parameters: dict[str, Value]
    confidence: float
    held_out_gain: float
    """Share of the residual without it that it closes, on what was held out."""
    confused_with: dict[str, float] = field(default_factory=dict)
    """Alternative effects and their probabilities."""
    at_bound: tuple[str, ...] = ()
    """Parameters at a bound of their range."""
    varies_with: str = ""
    """Condition with which its parameters vary: then it is probably misspecified."""
    whatever_else: float = 0.0
    """Share of the probability of all sets of effects that those with it have."""
    inside: tuple[str, ...] = ()
    """Parameters of the simulator's own by which it is realised; none: it is wrapped around it."""
    alike: tuple[str, ...] = ()
    """Terms that are the same over what was driven, the nearest first; of an effect none."""
    unusual: tuple[str, ...] = ()
    """Numbers outside what 5 to 95 % of real cars have."""
    undetermined: tuple[str, ...] = ()
    """Numbers whose interval is wider than what they can mean."""

    @property
    def realised(self) -> str:
        """How the repaired simulator has it, as `diagnosis.json` says."""
        if not self.inside:
            return "effect"
        return f"parameter{'s' * (len(self.inside) > 1)} {', '.join(self.inside)}"

    def line(self, unknown: bool = False) -> str:
        """Sentence, name and confidence of an effect, and what speaks against it."""
        said = min(self.confidence, SUREST)
        text = f"{self.name}, confidence {said:.0%}"
        if unknown and certainly_missing(self.whatever_else, self.confidence):
            text += (
                f"; whatever else is missing: in {self.whatever_else:.0%} of what may explain it"
            )
        if self.confused_with:
            others = ", ".join(f"{name} ({p:.0%})" for name, p in self.confused_with.items())
            text += f"; alternatives: {others}"
        if self.varies_with:
            condition = CONDITIONS[self.varies_with]
            text += f"; varies with {condition.varying or condition.words}: probably misspecified"
        if self.inside and self.kind != "parameter":
            text += f"; in the simulator: {self.realised}"
        if self.unusual:
            text += f"; unusually large ({', '.join(self.unusual)})"
        if self.undetermined:
            text += f"; not determined: {', '.join(self.undetermined)}"
        if self.at_bound:
            text += f"; at a bound of its range: {', '.join(self.at_bound)}"
        return f"{self.sentence[:1].upper()}{self.sentence[1:]} [{text}]."

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "name": self.name,
            "kind": self.kind,
            "equation": self.equation,
            "sentence": self.sentence,
            "parameters": {k: vars(v) for k, v in self.parameters.items()},
            "confidence": self.confidence,
            "held_out_gain": self.held_out_gain,
            "confused_with": [{"name": n, "confidence": c} for n, c in self.confused_with.items()],
            "at_bound": list(self.at_bound),
            "varies_with": self.varies_with,
            "whatever_else": self.whatever_else,
            "realised": self.realised,
            "unusual": list(self.unusual),
            "undetermined": list(self.undetermined),
            "alike": list(self.alike),
        }


@dataclass(frozen=True)
class Confidence:
    """Confidence in one effect of the best hypothesis."""

    probability: float
    alternatives: dict[str, float]
    """Other effects in its place -> their probability."""
    whatever_else: float
    """Probability if effects are missing at all."""


def name_effect(
    case: DiagnosisCase, found: SearchResult, effect: str, sure: Confidence
) -> NamedEffect:
    """An effect of the best hypothesis with its numbers, and what speaks for and against it."""
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
    # Without a baseline nothing shows that the simulator was right but for this.
    doubtful = effect_implausible(library.numbers(effect), numbers)
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
        unusual=unusual(library.numbers(effect), numbers),
        undetermined=undetermined(library.numbers(effect), values, problem.segments),
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


def sentence(
    effect: str,
    values: Mapping[str, float],
    unit: str = "",
    was: float = 0.0,
    command: LongitudinalCommand = ONE_WAY,
    car: VehicleDimensions | None = None,
) -> str:
    """An effect, or a wrong parameter of the simulator's own, in the words of its command and car.

    Without a car the words name no force or mass of it.
    """
    if effect.startswith("parameter:"):
        name = effect.partition(":")[2]
        value = f"{values[name]:.3g}" + (f" {unit}" if unit not in ("", "-") else "")
        return f"the simulator's {name.replace('_', ' ')} is {value}, not {was:.3g}"
    kind = effect_class(effect)
    if car is None:
        return kind.sentence_for(values, command)
    return kind.said(values, car, command)


FAR_CLOCK = 3 * CLOCK_PRIOR * CLOCK.size  # [s] three standard deviations of a stamp's error
CLOCKLIKE = ("sensor_latency",)  # effects that are a clock's error as well
WHOLE = 0.95  # [-] share of a number's range that an interval without meaning spans
IMPLAUSIBLE = (
    4.0  # times as far from neutral as the usual end: beyond all that is drawn, by a third
)
LATE = 0.015  # [s] by which clocks may differ without a word
PLACES = ("x", "y")  # numbers that are places in the room, in effects that have a radius


def unusual(numbers: Sequence[EffectParameter], values: Mapping[str, float]) -> tuple[str, ...]:
    """Names of numbers outside what 5 to 95 % of real cars have."""
    return tuple(
        p.name
        for p in numbers
        if p.usual is not None and not p.usual[0] <= values[p.name] <= p.usual[1]
    )


def effect_implausible(numbers: Sequence[EffectParameter], values: Mapping[str, float]) -> bool:
    """Whether a number is so far beyond the usual ones that another effect is more probable.

    Distances are of the normalised value from neutral. Sizes that development cases draw, to
    which the probabilities are calibrated, are all within.
    """
    for p in numbers:
        if p.usual is not None:
            found, *ends = (p.coordinate(v) for v in (values[p.name], *p.usual))
            low, high = min(0.0, *ends), max(0.0, *ends)
            if not IMPLAUSIBLE * low <= found <= IMPLAUSIBLE * high:
                return True
    return False


def undetermined(
    numbers: Sequence[EffectParameter], values: Mapping[str, Value], segments: Segments
) -> tuple[str, ...]:
    """Names of numbers whose interval is wider than what the number can mean.

    A place in the room means something within what was driven; another number within its range.
    """
    patch = "radius" in {p.name for p in numbers}
    driven = segments.pose[..., :2].flatten(0, 1)
    room = (driven.amax(0) - driven.amin(0)).tolist()  # [m] along x and y
    found = []
    for p in numbers:
        width = values[p.name].high - values[p.name].low
        if patch and p.name in PLACES:
            meant = room[PLACES.index(p.name)]
        elif patch and p.name == "radius":
            meant = float(torch.tensor(room).norm())
        else:
            meant = WHOLE * (p.upper - p.lower)
        if width >= meant:
            found.append(p.name)
    return tuple(found)


def latencies_refused(clock_offset: float) -> tuple[str, ...]:
    """Effects that are not named beside a clock that is itself off by more than stamps are.

    Of a late sensor and an early clock only the difference is known: their numbers may be anything.
    """
    return CLOCKLIKE if abs(clock_offset) >= FAR_CLOCK - 1e-6 else ()


def check_clock(offset: float) -> list[str]:
    """Whether the commands' clock as fitted [s] is that of the motion."""
    if abs(offset) <= LATE:
        return []
    side = "later" if offset > 0 else "earlier"
    return [
        f"commands act {1000 * abs(offset):.0f} ms {side} than they are stamped, throttle and "
        "steering alike: the clocks of commands and motion differ, or both commands are late. "
        "Compare the clocks; where the stamps are off, add "
        f"{offset:+.3f} s to command_offset of the column map and diagnose again"
    ]


def check_latency(effects: Collection[str], offset: float = 0.0) -> list[str]:
    """Says what else a late sensor could be, with the commands' clock as fitted [s]."""
    if "sensor_latency" not in effects:
        return []
    if latencies_refused(offset):
        return [
            "a late sensor was fitted beside a clock that is off by more than stamps are: only the "
            "difference of both is known, so none is named; compare the clocks of commands and "
            "motion, correct command_offset of the column map, and diagnose again"
        ]
    return [
        "a sensor that is late and commands that are stamped too early by as much are the same to "
        "these drives: compare the clocks of both before anything is built on it"
    ]
