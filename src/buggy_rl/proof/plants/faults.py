"""Faults of the plants that are not the reference car, by their textbook names; all neutral.

Signs, units and meaning are those of the reference car's table; each plant's docstring says where
the fault acts in it.
"""

from collections.abc import Mapping
from dataclasses import replace

from buggy_rl.simulators.reference.faults import TEXTBOOK, effect_of

LONGEST_DEAD_TIME = 0.17  # [s] what the plants' 0.25 s of commands hold beside their own 0.08 s
UPPER = {  # where the plants' range differs from the reference car's
    "throttle_dead_time.dead_time": LONGEST_DEAD_TIME,
    "steering_dead_time.dead_time": LONGEST_DEAD_TIME,
    "tire_grip.grip": 1.5,
}
FAULTS = {f.name: replace(f, upper=UPPER.get(f.name, f.upper)) for f in TEXTBOOK}
EFFECTS = frozenset(effect_of(name) for name in FAULTS)
# No fault by themselves.
PLACES = ("grip_patch.x", "grip_patch.y", "thermal_foldback.time_constant")


class PlantFaults:
    """The faults of a plant, equal in all environments.

    `faults["wind.force_x"]` is a number, `"wind" in faults` says whether there is such a fault.

    Args:
        given: `{effect: {parameter: value}}`; what is not named is neutral.
        abilities: Effects the plant can have.
        plant: Its name, for errors.

    Raises:
        KeyError: The plant has no such effect, or the effect no such parameter.
        ValueError: A value is outside its range.
    """

    def __init__(
        self, given: Mapping[str, Mapping[str, float]], abilities: frozenset[str], plant: str
    ) -> None:
        unknown = sorted(set(given) - abilities)
        if unknown:
            raise KeyError(
                f"the {plant} plant has no effect {', '.join(unknown)}; "
                f"available: {', '.join(sorted(abilities))}"
            )
        self.given = {effect: dict(parameters) for effect, parameters in given.items()}
        self._values = {name: fault.value for name, fault in FAULTS.items()}
        for effect, parameters in self.given.items():
            for parameter, value in parameters.items():
                self._values[f"{effect}.{parameter}"] = _checked(effect, parameter, float(value))
        self.active = frozenset(
            effect_of(name)
            for name, value in self._values.items()
            if value != FAULTS[name].value and name not in PLACES
        )

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, effect: object) -> bool:
        return effect in self.active


def _checked(effect: str, parameter: str, value: float) -> float:
    name = f"{effect}.{parameter}"
    if name not in FAULTS:
        known = [n.partition(".")[2] for n in FAULTS if effect_of(n) == effect]
        raise KeyError(f"effect {effect} has no parameter {parameter}; it has {', '.join(known)}")
    fault = FAULTS[name]
    if not fault.lower <= value <= fault.upper:
        raise ValueError(
            f"fault {name} is {value:g} {fault.unit}: must be in [{fault.lower:g}, {fault.upper:g}]"
        )
    return value
