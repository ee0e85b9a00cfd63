"""Effects that a simulator realises by parameters that it declares."""

from collections.abc import Mapping
from dataclasses import replace

import torch
from torch import Tensor

from buggy_rl.core.parameters import Change, Parameter, Realisations
from buggy_rl.effects import effect_class
from buggy_rl.effects.base import EffectParameter


class Inside:
    """Effects of a library that are realised inside the simulator.

    Args:
        realises: What the simulator declares; effects that are not in `effects`, and those whose
            parameters cannot be changed so (a factor on a parameter that is 0), are left out.
        declared: Its parameters.
        effects: Names of the library.

    Raises:
        ValueError: An entry names a parameter that is not declared, or leaves a number of its
            effect without a parameter.
    """

    def __init__(
        self,
        realises: Realisations,
        declared: Mapping[str, Parameter],
        effects: list[str],
    ) -> None:
        self.declared = declared
        self.changes: dict[str, tuple[Change, ...]] = {}
        for effect, changes in realises.items():
            _check(effect, {c.parameter: c for c in changes}, {c.number for c in changes}, declared)
            possible = all(c.possible(declared[c.parameter].value) for c in changes)
            if effect in effects and possible:
                self.changes[effect] = tuple(changes)

    def __contains__(self, effect: object) -> bool:
        return effect in self.changes

    @property
    def replaced(self) -> set[str]:
        """Parameters that an effect is the only name of: what it changes is that one alone.

        One of several that an effect changes, such as the front grip, may be wrong by itself.
        """
        return {own[0].parameter for own in self.changes.values() if len(own) == 1}

    def parameters_of(self, effect: str) -> tuple[str, ...]:
        """Parameters that an effect changes; none where it is wrapped around the simulator."""
        return tuple(c.parameter for c in self.changes.get(effect, ()))

    def bounded(self, effect: str, number: EffectParameter) -> EffectParameter:
        """A number of an effect, within the declared ranges of the parameters that follow from it.

        Towards a side on which the wrapped effect ends at neutral, the declared range alone counts:
        a simulated dead time may be too long as well.
        """
        ends = [self._ends(c) for c in self.changes[effect] if c.number == number.name]
        low, high = max(low for low, _ in ends), min(high for _, high in ends)
        if number.lower < number.value:
            low = max(low, number.lower)
        if number.upper > number.value:
            high = min(high, number.upper)
        low, high = min(low, number.value), max(high, number.value)
        probe = number.probe if low <= number.value + number.probe <= high else -number.probe
        return replace(number, lower=low, upper=high, probe=probe)

    def _ends(self, change: Change) -> tuple[float, float]:
        """Numbers at which a parameter is at the ends of its range."""
        p = self.declared[change.parameter]
        low, high = sorted(change.number_at(p.value, end) for end in (p.lower, p.upper))
        return low, high

    def moved(
        self, effects: dict[str, dict[str, Tensor]], parameters: dict[str, Tensor]
    ) -> tuple[dict[str, dict[str, Tensor]], dict[str, Tensor]]:
        """Settings with the effects inside taken from the wrapped ones to the parameters.

        Args:
            effects: Effect -> number -> values.
            parameters: Of the simulator's own, name -> values.
        """
        around = {name: values for name, values in effects.items() if name not in self}
        inside = dict(parameters)
        for effect, values in effects.items():
            for c in self.changes.get(effect, ()):
                p, number = self.declared[c.parameter], values[c.number]
                before = inside.get(c.parameter, torch.full_like(number, p.value))
                # Several effects together may lead out: an engine may refuse what is out of bounds.
                inside[c.parameter] = c.changed(before, number).clamp(p.lower, p.upper)
        return around, inside

    def values(
        self, effects: Mapping[str, Mapping[str, float]], parameters: Mapping[str, float]
    ) -> dict[str, float]:
        """The simulator's parameters with effects inside.

        Args:
            effects: Effect -> number -> value, each realised inside.
            parameters: That differ from the declared ones, by name.
        """
        double = torch.float64
        numbers = {
            effect: {name: torch.tensor(v, dtype=double) for name, v in own.items()}
            for effect, own in effects.items()
        }
        given = {name: torch.tensor(v, dtype=double) for name, v in parameters.items()}
        return {name: float(v) for name, v in self.moved(numbers, given)[1].items()}


def _check(
    effect: str,
    parameters: Mapping[str, Change],
    numbers: set[str],
    declared: Mapping[str, Parameter],
) -> None:
    kind = effect_class(effect)
    free = {p.name for p in kind.declared} - {*kind.alternatives}
    if unknown := sorted(set(parameters) - set(declared)):
        raise ValueError(
            f"realises[{effect!r}] changes {', '.join(unknown)}, which the simulator does not "
            f"declare; declared: {', '.join(sorted(declared)) or 'none'}"
        )
    if numbers != free:
        raise ValueError(
            f"realises[{effect!r}] is of {', '.join(sorted(numbers)) or 'no number'}: expected "
            f"changes by each of {', '.join(sorted(free))} and nothing else"
        )
