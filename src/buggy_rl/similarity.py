"""How the numbers of one car scale to another: ranges, start values, lengths of a task.

Cars of one shape under the same gravity are dynamically similar (Froude): forces go with m g,
lengths with L, speeds with sqrt(g L) unless the top speed is known. Grip, slip angles and
steering angles stay. So do dead times and lags: they are electronics'. Powers m g v are voltage
times current, each of which goes with their root: resistances stay.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

from buggy_rl.parameters import Parameter
from buggy_rl.vehicle import VehicleDimensions

# Unit -> exponents of mass, length, speed; gravity is the same for all.
EXPONENTS: dict[str, tuple[float, float, float]] = {
    **{"-": (0, 0, 0), "rad": (0, 0, 0), "1/rad": (0, 0, 0), "s": (0, 0, 0)},
    **{"m": (0, 1, 0), "m/s": (0, 0, 1), "m/s^2": (0, 0, 0), "s/m": (0, 0, -1)},
    **{"kg": (1, 0, 0), "kg m^2": (1, 2, 0), "N": (1, 0, 0), "N/rad": (1, 0, 0)},
    **{"N s/m": (1, 0, -1), "N s/(m rad)": (1, 0, -1), "N s^2/m^2": (1, 0, -2)},
    **{"N/m": (1, -1, 0), "rad/s": (0, -1, 1), "1/s": (0, 0, -1), "Hz": (0, -0.5, 0)},
    **{"kg/m": (1, 0, -2), "1/m": (0, 0, -2), "rad/s^2": (0, -1, 0), "W/kg": (0, 0, 1)},
    **{"V": (0.5, 0, 0.5), "A": (0.5, 0, 0.5), "A s": (0.5, 0, 1.5), "ohm": (0, 0, 0)},
    **{"V s/rad": (0.5, 1, -0.5), "1/J": (-1, 0, -2), "1/min": (0, 0, 0), "s^2/m": (0, 0, 0)},
    **{"rad s^2/m": (0, 0, 0), "m/(s^2 rad)": (0, 0, 0)},
}


@dataclass(frozen=True)
class Similarity:
    """Ratios of a car to the buggy; those of the buggy itself are exactly 1."""

    mass: float = 1.0
    length: float = 1.0
    speed: float = 1.0

    @classmethod
    def between(
        cls,
        car: VehicleDimensions,
        reference: VehicleDimensions | None = None,
        speed: float | None = None,
    ) -> "Similarity":
        """Ratios of a car to another, the buggy by default.

        Args:
            car: The one.
            reference: The other.
            speed: Ratio of their speeds; sqrt of the ratio of their wheelbases by default.
        """
        reference = reference or VehicleDimensions()
        length = car.wheelbase / reference.wheelbase
        return cls(car.mass / reference.mass, length, math.sqrt(length) if speed is None else speed)

    @property
    def time(self) -> float:
        """Ratio of the times in which the cars drive lengths of their own, L / S."""
        return self.length / self.speed

    def of(self, unit: str) -> float:
        """Factor of a quantity of this unit.

        Raises:
            KeyError: The unit is not known.
        """
        if unit not in EXPONENTS:
            known = ", ".join(EXPONENTS)
            raise KeyError(f"no scaling law for the unit {unit!r}; available: {known}")
        mass, length, speed = EXPONENTS[unit]
        return self.mass**mass * self.length**length * self.speed**speed

    def scaled(self, parameter: Parameter) -> Parameter:
        """A parameter of the buggy with the value and the range of this car."""
        p, factor = parameter, self.of(parameter.unit)
        ends = (factor * p.lower, factor * p.upper)
        return Parameter(p.name, factor * p.value, *ends, p.unit, p.meaning)


def similar_dimensions(known: Mapping[str, float]) -> VehicleDimensions:
    """Dimensions of a car of which some are known; the others are those of a scaled buggy.

    Lengths go with the wheelbase, the yaw inertia with m L^2. Without a mass or a wheelbase it is
    the buggy's.

    Args:
        known: Fields of `VehicleDimensions`.

    Raises:
        ValueError: A name is not a dimension, or mass or wheelbase is not positive.
    """
    names, buggy = [f.name for f in fields(VehicleDimensions)], VehicleDimensions()
    unknown = sorted(set(known) - set(names))
    if unknown:
        raise ValueError(f"no dimension {', '.join(unknown)}; available: {', '.join(names)}")
    given = {"mass": buggy.mass, "wheelbase": buggy.wheelbase} | dict(known)
    for name in ("mass", "wheelbase"):
        if not given[name] > 0:
            raise ValueError(f"dimensions: {name} is {given[name]}: must be above 0")
    mass, length = given["mass"] / buggy.mass, given["wheelbase"] / buggy.wheelbase
    factor = dict.fromkeys(names, length) | {"yaw_inertia": mass * length**2}
    scaled = {name: factor[name] * getattr(buggy, name) for name in names}
    return VehicleDimensions(**(scaled | given))
