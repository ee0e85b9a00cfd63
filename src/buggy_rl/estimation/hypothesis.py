"""What may be missing or wrong: effects by name, and the simulator's own parameters."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.segments import Stretches
from buggy_rl.parameters import Parameter

PRIOR = 3.0  # sd of a parameter in units of its size: wide, a fit is not to be pulled
# Later by a sample and a half at most: by more, a clock is no other than a sensor that is late.
CLOCK = EffectParameter(
    "clock_offset", 0.0, -0.1, 0.015, "s", "Commands act later than stamped.", 0.01, 0.002
)
CLOCK_PRIOR = 0.5  # in units of its size: a stamp is off by a sample at most
OWN = "parameter:"  # begins the name of a parameter of the simulator's own
SIZES = (0.4, 1.5)  # typical sizes at which an effect is tried before it is fitted
PATCHES = (0.1, 0.37, 0.63, 0.9)  # of the range driven, along x and y: where a patch is tried


@dataclass(frozen=True)
class Unknown:
    """One number of an explanation."""

    cause: str
    """An effect, a parameter of the simulator (`parameter:friction`), or empty for the clock."""
    parameter: EffectParameter
    prior: float
    """Standard deviation about neutral, in units of its size."""


class Library:
    """Causes to choose from.

    Args:
        effects: Names, also one's own as file.py:Class; all of `EFFECTS` by default.
        parameters: What the simulator declares.
        own: Whether those may be a cause.
    """

    def __init__(
        self,
        effects: Sequence[str] | None = None,
        parameters: Mapping[str, Parameter] | None = None,
        own: bool = True,
    ) -> None:
        self.own = own
        self.effects = list(EFFECTS if effects is None else effects)
        self.parameters = {name: _own(p) for name, p in (parameters or {}).items()}

    @property
    def causes(self) -> list[str]:
        """All names."""
        return [*self.effects, *(OWN + name for name in self.parameters if self.own)]

    def numbers(self, cause: str) -> tuple[EffectParameter, ...]:
        """What is unknown of a cause."""
        if cause.startswith(OWN):
            return (self.parameters[cause.removeprefix(OWN)],)
        kind = effect_class(cause)
        return tuple(p for p in kind.declared if p.name not in kind.alternatives)

    def deciding(self, cause: str) -> frozenset[str]:
        """Numbers of a cause that say how much of it there is; the others say where, or how."""
        own = () if cause.startswith(OWN) else effect_class(cause).deciding
        return frozenset(own or (p.name for p in self.numbers(cause)))

    def unknowns(self, causes: Sequence[str]) -> tuple[Unknown, ...]:
        """Numbers of an explanation; the commands' clock is always one of them, the last."""
        own = [Unknown(c, p, PRIOR) for c in causes for p in self.numbers(c)]
        return (*own, Unknown("", CLOCK, CLOCK_PRIOR))

    def settings(
        self, rows: Sequence[tuple[tuple[Unknown, ...], Tensor]]
    ) -> tuple[dict[str, dict[str, Tensor]], dict[str, Tensor], Tensor]:
        """Values of explanations, one a row, as `Player.play` takes them.

        Args:
            rows: Unknowns of each and their coordinates [P], or [N, P] of each stretch.

        Returns:
            Effects, the simulator's parameters, and the clock's offset; [C] or [C, N] each.
        """
        shape = (len(rows), *rows[0][1].shape[:-1])
        effects: dict[str, dict[str, Tensor]] = {}
        parameters: dict[str, Tensor] = {}
        offset = torch.zeros(shape)
        for row, (own, place) in enumerate(rows):
            for unknown, z in zip(own, place.unbind(-1), strict=True):
                value, name = unknown.parameter.value_at(z).float(), unknown.parameter.name
                if not unknown.cause:
                    offset[row] = value
                elif unknown.cause.startswith(OWN):
                    neutral = self.parameters[name].value
                    parameters.setdefault(name, torch.full(shape, neutral))[row] = value
                else:
                    if unknown.cause not in effects:
                        effects[unknown.cause] = {
                            p.name: torch.full(shape, p.value)
                            for p in effect_class(unknown.cause).declared
                        }
                    effects[unknown.cause][name][row] = value
        return effects, parameters, offset

    def trials(self, cause: str, cut: Stretches) -> list[list[float]]:
        """Places at which a cause is tried before it is fitted; both signs where it has two."""
        numbers = self.numbers(cause)
        if {"x", "y", "radius"} <= {p.name for p in numbers}:
            return _patches(numbers, cut)
        result = []
        both_ways = all(p.lower < p.value < p.upper for p in numbers)
        for size in SIZES:
            if len(numbers) == 2 and both_ways:  # the parts of a vector
                result += [[size, 0.0], [-size, 0.0], [0.0, size], [0.0, -size]]
                continue
            # Towards where it is probed: the rate of a limit falls while its coordinate grows.
            result.append([math.copysign(size, p.coordinate(p.value + p.probe)) for p in numbers])
            if both_ways:
                result.append([-z for z in result[-1]])
        return result


def bounded(unknowns: Sequence[Unknown], place: Tensor) -> Tensor:
    """A place [P] within the parameters' bounds."""
    ends = [
        sorted(u.parameter.coordinate(b) for b in (u.parameter.lower, u.parameter.upper))
        for u in unknowns
    ]
    low, high = torch.tensor(ends, dtype=place.dtype).unbind(-1)
    return torch.minimum(torch.maximum(place, low), high)


def _own(parameter: Parameter) -> EffectParameter:
    """A parameter of the simulator: a fifth of its value, or of its range, is a typical fault."""
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


def _patches(numbers: Sequence[EffectParameter], cut: Stretches) -> list[list[float]]:
    """Half the grip within 1 m of a grid of places over what was driven."""
    driven = cut.pose[..., :2].flatten(0, 1)
    low, high = torch.quantile(driven[::7], torch.tensor([0.1, 0.9]), 0).unbind(0)
    result = []
    for a in PATCHES:
        for b in PATCHES:
            x, y = (low + torch.tensor([a, b]) * (high - low)).tolist()
            own = {"radius": 1.0, "grip": 0.5, "x": x, "y": y}
            result.append([float(p.coordinate(own[p.name])) for p in numbers])
    return result
