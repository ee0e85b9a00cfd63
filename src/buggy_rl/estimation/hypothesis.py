"""Hypotheses: sets of effects and wrong parameters, and their numbers as one normalised vector."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import torch
from torch import Tensor

from buggy_rl.core.parameters import Parameter, Realisations
from buggy_rl.core.vehicle import EXPONENTS, Similarity
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.terms.grammar import BANK, PLACES, PREFIX, Term, number_in_bank
from buggy_rl.estimation.inside import Inside
from buggy_rl.estimation.rollout import ParameterSets
from buggy_rl.estimation.segments import Segments


def scaled_prior(parameter: EffectParameter, similarity: Similarity) -> EffectParameter:
    """A parameter of an effect with the prior scale that it has in a similar car.

    The neutral value stays, and bounds are widened where the car's are wider. A unit without a
    scaling law stays as it is.

    Args:
        parameter: As the effect declares it, for the buggy.
        similarity: Ratios of the car to the buggy.
    """
    p, factor = parameter, similarity.of(parameter.unit) if parameter.unit in EXPONENTS else 1.0
    if factor == 1.0:
        return p
    return replace(
        p,
        size=factor * p.size,
        probe=p.probe if p.reciprocal else factor * p.probe,
        lower=min(p.lower, factor * p.lower),
        upper=p.upper if p.reciprocal else max(p.upper, factor * p.upper),
        usual=_usual(p, factor),
    )


def _usual(p: EffectParameter, factor: float) -> tuple[float, float] | None:
    """The usual values of the car; the neutral one, which stays, is among them."""
    if p.usual is None:
        return None
    low, high = factor * p.usual[0], factor * p.usual[1]
    return (low, high) if p.reciprocal else (min(low, p.value), max(high, p.value))


PRIOR = 3.0  # [prior scales] standard deviation of a parameter: wide, so that data decide
# Later by a sample and a half at most: beyond, a clock is no other than a sensor that is late.
CLOCK = EffectParameter(
    "clock_offset", 0.0, -0.1, 0.015, "s", "Commands act later than stamped.", 0.01, 0.002
)
CLOCK_PRIOR = 0.5  # [prior scales of 0.01 s] a stamp is off by a sample at most
OWN = "parameter:"  # begins the name of a parameter of the simulator's own
TRIAL_SIZES = (0.4, 1.5)  # [prior scales] at which an effect is screened
LIMIT = 8 / 3  # times as far a limit is: a small one is never reached, and shows nothing
PATCH_GRID = (0.1, 0.37, 0.63, 0.9)  # [-] of the driven range along x and y: patches screened
AT_BOUND = 1e-6  # [prior scales] distance from a bound within which a value lies at it


@dataclass(frozen=True)
class Coordinate:
    """One number of a hypothesis."""

    effect: str
    """An effect, a parameter of the simulator (`parameter:friction`), or empty for the clock."""
    parameter: EffectParameter
    prior: float
    """Standard deviation about neutral, in prior scales of the parameter."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Effects with numbers: z_p = (value_p - neutral_p) / scale_p, the clock's offset last."""

    effects: tuple[str, ...]
    """Effects, and parameters of the simulator's own as `parameter:NAME`."""
    coordinates: tuple[Coordinate, ...]
    vector: Tensor
    """[P] float64 normalised parameters z; 0 is neutral."""

    @property
    def prior(self) -> Tensor:
        """Standard deviations [P] of the coordinates."""
        return torch.tensor([c.prior for c in self.coordinates], dtype=torch.float64)

    def penalty(self, vector: Tensor | None = None) -> Tensor:
        """Negative log prior density, up to a constant [nats]."""
        vector = self.vector if vector is None else vector
        return 0.5 * (vector / self.prior).square().sum(-1)

    def at(self, vector: Tensor) -> "Hypothesis":
        """The same effects with other numbers [P], brought within their bounds."""
        return replace(self, vector=self.bounded(vector))

    def bounded(self, vector: Tensor) -> Tensor:
        """A vector [P] within the parameters' bounds."""
        ends = [
            sorted(c.parameter.coordinate(b) for b in (c.parameter.lower, c.parameter.upper))
            for c in self.coordinates
        ]
        low, high = torch.tensor(ends, dtype=vector.dtype).unbind(-1)
        return torch.minimum(torch.maximum(vector, low), high)

    @property
    def as_stamped(self) -> "Hypothesis":
        """Hypothesis without the clock's coordinate: commands act when they are stamped.

        A clock offset belongs to a recording. A simulator's file holds none, so what a file
        predicts is what its hypothesis predicts as stamped.
        """
        own = [i for i, c in enumerate(self.coordinates) if c.effect]
        coordinates = tuple(self.coordinates[i] for i in own)
        return Hypothesis(self.effects, coordinates, self.vector[own])

    def named(self) -> dict[tuple[str, str], float]:
        """(effect, parameter) -> coordinate."""
        numbers = zip(self.coordinates, self.vector.tolist(), strict=True)
        return {(c.effect, c.parameter.name): z for c, z in numbers}

    def values(self) -> dict[str, dict[str, float]]:
        """Effect -> parameter -> value, within its bounds also after rounding.

        The clock is under the empty name.
        """
        result: dict[str, dict[str, float]] = {}
        for c, z in zip(self.coordinates, self.vector.tolist(), strict=True):
            value = min(max(float(c.parameter.value_at(z)), c.parameter.lower), c.parameter.upper)
            result.setdefault(c.effect, {})[c.parameter.name] = value
        return result

    def at_bound(self, effect: str) -> tuple[str, ...]:
        """Parameters of an effect that lie at an end of their range."""
        values = self.values()[effect]
        numbers = {c.parameter.name: c.parameter for c in self.coordinates if c.effect == effect}
        return tuple(
            name
            for name, p in numbers.items()
            if min(abs(values[name] - p.lower), abs(values[name] - p.upper)) < AT_BOUND * p.size
        )


class Library:
    """Effects and parameters to choose from.

    Args:
        effects: Names, also a user's own as file.py:Class; all of `EFFECTS` by default.
        parameters: What the simulator declares.
        own: Whether those may be wrong.
        realises: Effects that the simulator realises by its parameters: their numbers act there.
        similarity: Ratios of the car to the buggy, whose prior scales the effects declare.
    """

    def __init__(
        self,
        effects: Sequence[str] | None = None,
        parameters: Mapping[str, Parameter] | None = None,
        own: bool = True,
        realises: Realisations | None = None,
        similarity: Similarity | None = None,
    ) -> None:
        self.own, self.similarity = own, similarity or Similarity()
        self.effects = list(EFFECTS if effects is None else effects)
        self.parameters = {name: _own(p) for name, p in (parameters or {}).items()}
        self.inside = Inside(realises or {}, self.parameters, self.effects)

    @property
    def names(self) -> list[str]:
        """Names that a hypothesis may hold; a parameter that is an effect has that name alone."""
        own = self.parameters if self.own else ()
        return [*self.effects, *(OWN + n for n in own if n not in self.inside.replaced)]

    def numbers(self, effect: str) -> tuple[EffectParameter, ...]:
        """Free parameters of an effect."""
        if effect.startswith(OWN):
            return (self.parameters[effect.removeprefix(OWN)],)
        kind = effect_class(effect)
        free = tuple(
            scaled_prior(p, self.similarity)
            for p in kind.declared
            if p.name not in kind.alternatives
        )
        if effect in self.inside:
            return tuple(self.inside.bounded(effect, p) for p in free)
        return free

    def may_delay(self, effect: str) -> bool:
        """Whether a fit without it may take its delay for an offset of the clock.

        Of a parameter of the simulator nobody knows.
        """
        return effect.startswith(OWN) or effect_class(effect).may_delay

    def hypothesis(self, effects: Sequence[str], vector: Sequence[float] = ()) -> Hypothesis:
        """Effects at normalised parameters, at neutral by default; the clock's is the last."""
        own = [Coordinate(e, p, PRIOR) for e in effects for p in self.numbers(e)]
        coordinates = (*own, Coordinate("", CLOCK, CLOCK_PRIOR))
        begin = list(vector) or [0.0] * len(coordinates)
        return Hypothesis(tuple(effects), coordinates, torch.tensor(begin, dtype=torch.float64))

    def at(self, effects: Sequence[str], known: Mapping[tuple[str, str], float]) -> Hypothesis:
        """Effects at coordinates by (effect, parameter); at neutral where none is known."""
        start = self.hypothesis(effects)
        keys = [(c.effect, c.parameter.name) for c in start.coordinates]
        return self.hypothesis(effects, [known.get(key, 0.0) for key in keys])

    def settings(self, rows: Sequence[tuple[Hypothesis, Tensor]]) -> ParameterSets:
        """Values of C hypotheses for a rollout.

        Args:
            rows: Each with its vector [P], or [N, P] with one for each segment.
        """
        shape = (len(rows), *rows[0][1].shape[:-1])
        effects: dict[str, dict[str, Tensor]] = {}
        parameters: dict[str, Tensor] = {}
        offset = torch.zeros(shape)
        first = 0
        for hypothesis, own in _runs(rows):
            of = slice(first, first + len(own))
            first += len(own)
            for c, z in zip(hypothesis.coordinates, own.unbind(-1), strict=True):
                value, name = c.parameter.value_at(z).float(), c.parameter.name
                if not c.effect:
                    offset[of] = value
                elif c.effect.startswith(PREFIX):
                    continue
                elif c.effect.startswith(OWN):
                    declared = self.parameters[name]  # an engine may refuse what is out of bounds
                    if name not in parameters:
                        parameters[name] = torch.full(shape, declared.value)
                    parameters[name][of] = value.clamp(declared.lower, declared.upper)
                else:
                    if c.effect not in effects:
                        numbers = effect_class(c.effect).declared
                        effects[c.effect] = {p.name: torch.full(shape, p.value) for p in numbers}
                    effects[c.effect][name][of] = value
            for bank, member, column in in_banks(hypothesis.effects, hypothesis.coordinates):
                if bank not in effects:
                    effects[bank] = {n: torch.zeros(shape) for n in ("member", "coefficient")}
                z, parameter = own[..., column], hypothesis.coordinates[column].parameter
                effects[bank]["member"][of] = float(member)
                effects[bank]["coefficient"][of] = parameter.value_at(z).float()
        return ParameterSets(*self.inside.moved(effects, parameters), offset)

    def trials(
        self, effect: str, segments: Segments, at: Sequence[float] = TRIAL_SIZES
    ) -> list[list[float]]:
        """Coordinates at which an effect is screened; both signs where it has two.

        Args:
            effect: Its name.
            segments: Where a patch may lie.
            at: Distances from neutral [prior scales].
        """
        numbers = self.numbers(effect)
        if {"x", "y", "radius"} <= {p.name for p in numbers}:
            return _patches(numbers, segments, self.similarity.length)
        result = []
        both_ways = all(p.lower < p.value < p.upper for p in numbers)
        for size in at:
            if len(numbers) == 2 and both_ways:  # the parts of a vector
                result += [[size, 0.0], [-size, 0.0], [0.0, size], [0.0, -size]]
                continue
            # Towards where it is probed: the rate of a limit falls while its coordinate grows.
            result.append([math.copysign(_far(p, size), _probed(p)) for p in numbers])
            if both_ways:
                result.append([-z for z in result[-1]])
        return result


def _runs(rows: Sequence[tuple[Hypothesis, Tensor]]) -> Iterator[tuple[Hypothesis, Tensor]]:
    """Hypotheses that follow one another and are the same, with their vectors [R, *, P]."""
    for _, run in groupby(rows, key=lambda row: id(row[0])):
        same = list(run)
        yield same[0][0], torch.stack([vector for _, vector in same])


def in_banks(
    effects: Sequence[str], coordinates: Sequence[Coordinate]
) -> list[tuple[str, int, int]]:
    """Bank of each term of a hypothesis, the term's number in it, and its coordinate's index.

    Terms of one kind have slots: one rollout holds hundreds of hypotheses with a term each at the
    cost of one effect.
    """
    taken: dict[str, int] = {}
    columns = {c.effect: i for i, c in enumerate(coordinates)}
    result = []
    for name in effects:
        if name.startswith(PREFIX):
            term = Term.parse(name)
            kind = PLACES[term.place].kind
            slot = taken.get(kind, 0)
            taken[kind] = slot + 1
            result.append((f"{BANK}{kind}.{slot}", number_in_bank(term), columns[name]))
    return result


def _far(number: EffectParameter, size: float) -> float:
    return LIMIT * size if number.reciprocal else size


def _probed(number: EffectParameter) -> float:
    """Coordinate of where a number is probed."""
    return float(number.coordinate(number.value + number.probe))


def _own(parameter: Parameter) -> EffectParameter:
    """A simulator's own parameter: its prior scale is a fifth of its value, or of its range."""
    size = 0.2 * abs(parameter.value) or 0.1 * (parameter.upper - parameter.lower)
    size = min(size, 0.5 * (parameter.upper - parameter.lower))
    upward = parameter.value + 0.1 * size <= parameter.upper
    return EffectParameter(
        parameter.name,
        parameter.value,
        parameter.lower,
        parameter.upper,
        parameter.unit,
        parameter.meaning,
        size,
        0.1 * size if upward else -0.1 * size,
    )


def _patches(
    numbers: Sequence[EffectParameter], segments: Segments, radius: float
) -> list[list[float]]:
    """Half the grip within a radius [m] of a grid of positions over what was driven."""
    driven = segments.pose[..., :2].flatten(0, 1)
    low, high = torch.quantile(driven[::7], torch.tensor([0.1, 0.9]), 0).unbind(0)
    result = []
    for a in PATCH_GRID:
        for b in PATCH_GRID:
            x, y = (low + torch.tensor([a, b]) * (high - low)).tolist()
            own = {"radius": radius, "grip": 0.5, "x": x, "y": y}
            result.append([float(p.coordinate(own[p.name])) for p in numbers])
    return result
