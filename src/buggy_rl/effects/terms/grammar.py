"""The grammar of terms: what is changed, by which signal, in which shape, after which lag.

A term adds `coefficient * shape(signal)` to one quantity of the car. Its name says all of it:
`term.yaw.throttle`, `term.forward.steering.even`, `term.side.speed_times_steering.linear.lag`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from typing import Literal

from buggy_rl.core.vehicle import EXPONENTS

PREFIX = "term."
BANK = "terms."
"""Begins the name of a bank: `terms.motion.0`."""
SLOTS = 4
"""Terms of one kind that a car may have at once."""
Kind = Literal["actuation", "motion", "sensing"]
TIMES = "_times_"
KINDS: tuple[Kind, ...] = ("actuation", "motion", "sensing")


@dataclass(frozen=True)
class Place:
    """What a term adds to."""

    symbol: str
    """Left side of its equation."""
    kind: Kind
    unit: str
    size: float
    """[unit] prior scale at a typical signal: shifts a rollout of 1 s by 20 to 30 mm at 2 m/s."""
    largest: float
    """[unit] that is added at most; at a typical signal, the bound of the coefficient."""
    says: str
    """What happens to the car where the addition is positive."""
    negative: str
    """What happens where it is negative."""


PLACES = {
    "forward": Place("dvx/dt", "motion", "m/s^2", 0.1, 10.0, "driven forward", "slowed"),
    "side": Place(
        "dvy/dt", "motion", "m/s^2", 0.1, 10.0, "pushed to the left", "pushed to the right"
    ),
    "yaw": Place(
        "dr/dt", "motion", "rad/s^2", 2.0, 200.0, "turned to the left", "turned to the right"
    ),
    "throttle": Place("throttle", "actuation", "-", 0.05, 2.0, "given more drive", "given less"),
    "steering": Place(
        "steering", "actuation", "-", 0.03, 2.0, "steered to the left", "steered to the right"
    ),
    "shown_vx": Place("shown vx", "sensing", "m/s", 0.05, 5.0, "shown too fast", "shown too slow"),
    "shown_vy": Place(
        "shown vy",
        "sensing",
        "m/s",
        0.05,
        5.0,
        "shown drifting to the left",
        "shown drifting to the right",
    ),
    "shown_yaw_rate": Place(
        "shown r",
        "sensing",
        "rad/s",
        0.1,
        10.0,
        "shown turning further left",
        "shown turning further right",
    ),
    "shown_heading": Place(
        "shown yaw",
        "sensing",
        "rad",
        0.02,
        1.5,
        "shown turned to the left",
        "shown turned to the right",
    ),
    "shown_ahead": Place(
        "shown position ahead",
        "sensing",
        "m",
        0.02,
        2.0,
        "shown too far ahead",
        "shown too far back",
    ),
    "shown_left": Place(
        "shown position left",
        "sensing",
        "m",
        0.02,
        2.0,
        "shown too far left",
        "shown too far right",
    ),
}


EVERYDAY = {
    "m/s^2": (1.0, "m/s a second"),
    "rad/s^2": (math.degrees(1.0), "degrees/s a second"),
    "-": (100.0, "% of full"),
    "m/s": (1.0, "m/s"),
    "rad/s": (math.degrees(1.0), "degrees a second"),
    "rad": (math.degrees(1.0), "degrees"),
    "m": (100.0, "cm"),
}
"""Unit of a place -> factor to an everyday one, and that."""


@dataclass(frozen=True)
class Signal:
    """What a term depends on."""

    symbol: str
    unit: str
    typical: float
    """[unit] on a lively drive of the buggy; where shapes bend and prior scales hold."""
    says: str
    at: str
    """Words for the typical value."""
    signed: bool = True
    """Whether it takes both signs, so that even and odd shapes differ."""


SIGNALS = {
    "one": Signal("1", "-", 1.0, "always", "", signed=False),
    "speed": Signal("v", "m/s", 2.0, "the speed", "2 m/s", signed=False),
    "lateral_acceleration": Signal("a_y", "m/s^2", 5.0, "the lateral acceleration", "half a g"),
    "yaw_rate": Signal("r", "rad/s", 2.5, "the yaw rate", "143 degrees a second"),
    "steering": Signal("steering", "-", 0.5, "the steering command", "half of full lock"),
    "throttle": Signal("drive", "-", 0.3, "the drive command", "30 % drive", signed=False),
    "steering_rate": Signal(
        "dsteering/dt",
        "1/s",
        3.0,
        "the rate of the steering command",
        "full lock to full lock in 0.7 s",
    ),
    "throttle_rate": Signal(
        "ddrive/dt", "1/s", 2.0, "the rate of the drive command", "full drive in 0.5 s"
    ),
    "time": Signal("t", "s", 30.0, "the time since the session began", "30 s", signed=False),
    "x": Signal("x", "m", 2.0, "the place in the room along x", "2 m"),
    "y": Signal("y", "m", 2.0, "the place in the room along y", "2 m"),
    "heading": Signal("yaw", "rad", 1.0, "the heading", ""),
}


@dataclass(frozen=True)
class Shape:
    """How a term depends on its signal s, whose typical value is s0."""

    text: str
    """Formula, with {s} for the signal, {p} for it as a factor, {s0} for where the shape bends."""
    power: int
    """Power of the signal's unit in the shape's."""
    parity: Literal["odd", "even"]
    says: str


SHAPES = {
    "linear": Shape("{s}", 1, "odd", "in proportion to"),
    "even": Shape("|{s}|", 1, "even", "in proportion to the magnitude of"),
    "odd_square": Shape("{p} |{s}|", 2, "odd", "with the signed square of"),
    "even_square": Shape("{p}^2", 2, "even", "with the square of"),
    "saturating": Shape("tanh({p} / {s0:g})", 0, "odd", "in the sense, soon in full, of"),
    "threshold": Shape(
        "sign({s}) max(|{s}| - {s0:g}, 0)", 1, "odd", "beyond a threshold in proportion to"
    ),
    "cos": Shape("cos({s})", 0, "even", "with the cosine of"),
    "sin": Shape("sin({s})", 0, "odd", "with the sine of"),
    "cos2": Shape("cos(2 {s})", 0, "even", "with the cosine of twice"),
    "sin2": Shape("sin(2 {s})", 0, "odd", "with the sine of twice"),
}
PERIODIC = ("cos", "sin", "cos2", "sin2")
BENT = ("linear", "even", "odd_square", "even_square", "saturating", "threshold")
ONE_SIDED = ("linear", "even_square", "saturating", "threshold")
LAG = 0.2  # [s] time constant of a term with memory; chosen: a car's own lags are 0.02 to 0.1
MEMORIES = ("none", "lag")


@dataclass(frozen=True, order=True)
class Term:
    """An equation with one coefficient."""

    place: str
    signals: tuple[str, ...]
    """One signal, or two whose product it is, in the order of `SIGNALS`."""
    shape: str = "linear"
    memory: str = "none"

    def __post_init__(self) -> None:
        known = (
            ("place", (self.place,), PLACES),
            ("signal", self.signals, SIGNALS),
            ("shape", (self.shape,), SHAPES),
            ("memory", (self.memory,), MEMORIES),
        )
        for what, names, table in known:
            for name in names:
                if name not in table:
                    raise ValueError(
                        f"a term has no {what} {name!r}; available: {', '.join(table)}"
                    )
        if not 1 <= len(self.signals) <= 2:
            raise ValueError(f"a term has one signal or two, not {len(self.signals)}")
        if ("heading" in self.signals) != (self.shape in PERIODIC):
            raise ValueError(
                f"shapes {', '.join(PERIODIC)} are those of the heading, and it has no other; "
                f"not {self.shape} of {TIMES.join(self.signals)}"
            )

    @classmethod
    def parse(cls, name: str) -> "Term":
        """The term of a name.

        Raises:
            ValueError: The name is not one of the grammar; the message says which part.
        """
        parts = name.removeprefix(PREFIX).split(".")
        if not name.startswith(PREFIX) or not 2 <= len(parts) <= 4:
            raise ValueError(
                f"{name!r} names no term: term.PLACE.SIGNAL[.SHAPE[.MEMORY]], such as "
                "term.yaw.throttle or term.forward.steering.even"
            )
        return cls(parts[0], tuple(parts[1].split(TIMES)), *parts[2:])

    @property
    def name(self) -> str:
        """Name, without what is the default."""
        shape = self.shape if (self.shape, self.memory) != ("linear", "none") else ""
        memory = self.memory if self.memory != "none" else ""
        return PREFIX + ".".join(
            p for p in (self.place, TIMES.join(self.signals), shape, memory) if p
        )

    @property
    def typical(self) -> float:
        """Typical value of the shape."""
        signal = 1.0
        for name in self.signals:
            signal *= SIGNALS[name].typical
        return signal ** SHAPES[self.shape].power

    @property
    def bend(self) -> float:
        """Signal at which the shape bends: half the typical one for a threshold."""
        signal = 1.0
        for name in self.signals:
            signal *= SIGNALS[name].typical
        return 0.5 * signal if self.shape == "threshold" else signal

    @property
    def size(self) -> float:
        """Prior scale of the coefficient."""
        return PLACES[self.place].size / self.typical

    @property
    def bound(self) -> float:
        """Largest magnitude of the coefficient."""
        return PLACES[self.place].largest / self.typical

    @property
    def unit(self) -> str:
        """Unit of the coefficient, for a person: `rad/s^2 per m/s`."""
        own, power = PLACES[self.place].unit, SHAPES[self.shape].power
        units = [SIGNALS[n].unit for n in self.signals if SIGNALS[n].unit != "-"] if power else []
        if not units:
            return own
        per = " ".join(f"({u})" if "/" in u else u for u in units)
        if power == 2:
            per = f"{per}^2" if len(units) == 1 else f"({per})^2"
        return f"{own if own != '-' else '1'} per {per}"

    @property
    def shape_of_signal(self) -> str:
        """The right side without the coefficient: `|steering|`, `tanh(a_y / 5)`."""
        signal = " ".join(SIGNALS[n].symbol for n in self.signals)
        factor = f"({signal})" if len(self.signals) > 1 else signal
        text = SHAPES[self.shape].text.format(s=signal, p=factor, s0=self.bend)
        return f"lag({text}, {LAG:g} s)" if self.memory == "lag" else text

    @property
    def equation(self) -> str:
        """Equation, with its coefficient as a letter."""
        place = PLACES[self.place]
        if place.kind == "motion":
            return f"{place.symbol} = ... + coefficient {self.shape_of_signal}"
        return f"{place.symbol}' = {place.symbol} + coefficient {self.shape_of_signal}"

    def sentence(self, coefficient: float) -> str:
        """What it does, in words and everyday units, at a typical signal."""
        place, shape = PLACES[self.place], SHAPES[self.shape]
        does = place.says if coefficient >= 0 else place.negative
        factor, unit = EVERYDAY[place.unit]
        number = f"{factor * abs(coefficient) * self.typical:.3g} {unit}"
        known = FIELD_NAMES.get((self.place, self.signals, shape.parity))
        named = f": {known}" if known else ""
        if self.signals == ("one",):
            return f"the car is {does} by {number} all the time{named}"
        signal = " times ".join(SIGNALS[n].says for n in self.signals)
        at = " and ".join(SIGNALS[n].at for n in self.signals)
        size = f"{number} at {at}" if shape.power else f"at most {number}"
        after = f", {LAG:g} s late" if self.memory == "lag" else ""
        return f"the car is {does} {shape.says} {signal}{after}, by {size}{named}"


FIELD_NAMES: dict[tuple[str, tuple[str, ...], str], str] = {
    ("steering", ("lateral_acceleration",), "odd"): "roll steer or compliance of the steering",
    ("steering", ("throttle",), "odd"): "torque steer",
    ("steering", ("throttle_rate",), "odd"): "bump steer of a body that pitches",
    ("yaw", ("throttle",), "odd"): "torque steer, an uneven drive",
    ("throttle", ("steering",), "even"): "brown-out of a supply that servo and motor share",
    ("throttle", ("steering_rate",), "even"): "brown-out of a supply that servo and motor share",
    ("forward", ("steering",), "even"): "drag of turned wheels",
    ("forward", ("yaw_rate",), "even"): "a drag that grows with turning",
    ("forward", ("lateral_acceleration",), "even"): "cornering drag",
    ("side", ("time",), "odd"): "tyres that heat or wear",
    ("steering", ("time",), "odd"): "a steering trim that drifts",
    ("throttle", ("time",), "odd"): "a battery that empties",
    ("forward", ("x",), "odd"): "a floor that is not level",
    ("forward", ("y",), "odd"): "a floor that is not level",
    ("shown_heading", ("lateral_acceleration",), "odd"): "a camera that tilts as the body rolls",
}
"""What the field calls a term, by place, signals and parity of the shape."""

# Terms that are an effect of the library, to first order: that is their only name.
NAMED: dict[tuple[str, tuple[str, ...], str], str] = {
    ("throttle", ("one",), "linear"): "throttle_offset",
    ("throttle", ("throttle",), "linear"): "throttle_gain",
    ("steering", ("one",), "linear"): "steering_offset",
    ("steering", ("steering",), "linear"): "steering_gain",
    ("steering", ("steering",), "even"): "steering_asymmetry",
    ("steering", ("steering",), "odd_square"): "steering_curve",
    ("steering", ("steering",), "threshold"): "steering_curve",
    ("steering", ("steering",), "saturating"): "steering_dead_zone",
    ("steering", ("steering_rate",), "linear"): "steering_lag",
    ("throttle", ("throttle_rate",), "linear"): "throttle_lag",
    ("throttle", ("throttle", "time"), "linear"): "battery_sag",
    ("throttle", ("throttle",), "saturating"): "throttle_deadband",
    ("forward", ("one",), "linear"): "rolling_resistance",
    ("forward", ("speed",), "linear"): "viscous_drag",
    ("forward", ("speed",), "even_square"): "aerodynamic_drag",
    ("forward", ("speed",), "saturating"): "rolling_resistance",
    ("forward", ("throttle",), "linear"): "throttle_gain",
    ("forward", ("lateral_acceleration",), "even_square"): "cornering_drag",
    ("forward", ("steering",), "even_square"): "steering_drag",
    ("yaw", ("yaw_rate",), "linear"): "yaw_damping",
    ("yaw", ("one",), "linear"): "one_sided_drag",
    ("yaw", ("speed",), "saturating"): "one_sided_drag",
    ("yaw", ("throttle",), "linear"): "torque_steer",
    ("forward", ("heading",), "cos"): "floor_slope",
    ("forward", ("heading",), "sin"): "floor_slope",
    ("side", ("heading",), "cos"): "floor_slope",
    ("side", ("heading",), "sin"): "floor_slope",
    ("shown_vx", ("speed",), "linear"): "speed_scale",
    ("shown_vy", ("yaw_rate",), "linear"): "sensor_lever_arm",
    ("shown_vx", ("yaw_rate",), "linear"): "sensor_lever_arm",
    ("shown_ahead", ("one",), "linear"): "sensor_lever_arm",
    ("shown_left", ("one",), "linear"): "sensor_lever_arm",
    ("shown_ahead", ("speed",), "linear"): "sensor_latency",
    ("shown_heading", ("yaw_rate",), "linear"): "sensor_latency",
    ("shown_heading", ("one",), "linear"): "sensor_yaw",
    ("shown_heading", ("time",), "linear"): "heading_drift",
    ("shown_yaw_rate", ("one",), "linear"): "gyro_bias",
}

PRODUCTS = tuple(
    pair
    for pair in combinations(
        ("speed", "lateral_acceleration", "yaw_rate", "steering", "throttle", "time"), 2
    )
    if pair != ("speed", "time")
)
LAGGED = ("lateral_acceleration", "yaw_rate", "steering", "throttle", "speed")
"""Signals of terms with memory, in the linear and the even shape."""


SEEN = ("one", "speed", "lateral_acceleration", "yaw_rate", "x", "y", "heading")
"""Signals of a sensor's terms: of the motion alone, which a measurement shows."""


@cache
def terms() -> tuple[Term, ...]:
    """All terms that are searched; each is no effect of the library."""
    return tuple(t for t in _all() if (t.place, t.signals, t.shape) not in NAMED)


@cache
def terms_of(kind: Kind) -> tuple[Term, ...]:
    """Terms of `terms()` that change commands, the motion, or what a sensor shows."""
    return tuple(t for t in terms() if PLACES[t.place].kind == kind)


@cache
def _numbers(kind: Kind) -> dict[Term, int]:
    return {term: number for number, term in enumerate(terms_of(kind))}


def number_in_bank(term: Term) -> int:
    """Index of a term in the bank of its kind."""
    return _numbers(PLACES[term.place].kind)[term]


def _all() -> Iterator[Term]:
    for place, about in PLACES.items():
        seen = SEEN if about.kind == "sensing" else tuple(SIGNALS)
        for name in seen:
            yield from (Term(place, (name,), shape) for shape in _shapes(name))
        for pair in PRODUCTS:
            if set(pair) <= set(seen):
                yield Term(place, pair)
                if any(SIGNALS[name].signed for name in pair):
                    yield Term(place, pair, "even")
        if about.kind != "sensing":
            for name in LAGGED:
                yield Term(place, (name,), "linear", "lag")
                if SIGNALS[name].signed:
                    yield Term(place, (name,), "even", "lag")


def _shapes(signal: str) -> tuple[str, ...]:
    if signal == "one":
        return ("linear",)
    if signal == "heading":
        return PERIODIC
    return BENT if SIGNALS[signal].signed else ONE_SIDED


def scaling_unit(term: Term) -> str:
    """Unit by which a coefficient scales with the car; "-" where there is no law for it."""
    own = PLACES[term.place].unit
    return own if SHAPES[term.shape].power == 0 and own in EXPONENTS else "-"
