"""What a textbook term should come out as where a plant has the same thing in another form.

A fault in a car's own physics is not always the textbook's term at the commands or on the velocity:
where the two differ by a factor that is known, an answer is measured against the textbook's number.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from buggy_rl.blind_test.case import Case


@dataclass(frozen=True)
class Equivalent:
    """The textbook's number for the plant's."""

    number: Callable[[float], float]
    why: str


def _times(factor: float) -> Callable[[float], float]:
    return lambda value: factor * value


def _spinning(share: float) -> dict[str, dict[str, Equivalent]]:
    """What has wheels and rotor to move as well, for a share of the mass that is the car's."""
    slope = Equivalent(_times(share), "gravity has to spin the wheels up too")
    power = Equivalent(_times(share), "power at the shaft has to spin the wheels up too")
    return {
        "floor_slope": {"along_x": slope, "along_y": slope},
        "motor_power_limit": {"power_per_mass": power},
    }


# Of the reference car. Shares of mass: wheels and rotor add 11.8 % to what a force has to move.
ROLLING_MASS = 1.1176
TABLES: dict[str, Mapping[str, Mapping[str, Equivalent]]] = {
    "reference": _spinning(1 / ROLLING_MASS),
    "mujoco": _spinning(0.92),  # their wheels and rotors, as the plants' docstrings have it
    "commonroad": _spinning(0.90),
}


def expected(case: Case, effect: str) -> dict[str, float]:
    """The numbers that a right answer has for an effect of a case."""
    table = TABLES.get(case.plant, {}).get(effect, {})
    return {
        name: table[name].number(value) if name in table else value
        for name, value in case.concealed[effect].items()
    }


def error(effect: str, said: Mapping[str, float], truth: Mapping[str, float]) -> float:
    """How far an answer's numbers are off, relative to the true ones.

    |said - true| / |true|; of a vector the lengths; of a patch its middle over its radius, its
    radius and its grip, whichever is worst.
    """
    if effect == "grip_patch":
        middle = sum((said[k] - truth[k]) ** 2 for k in ("x", "y")) ** 0.5
        others = [abs(said[k] - truth[k]) / abs(truth[k]) for k in ("radius", "grip")]
        return max(middle / truth["radius"], *others)
    names = [name for name in truth if name in said]
    if not names:
        return float("inf")
    off = sum((said[k] - truth[k]) ** 2 for k in names) ** 0.5
    return off / sum(truth[k] ** 2 for k in names) ** 0.5
