"""The time stamps of a table: which columns they are, and how regular."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import UNITS
from buggy_rl.recordings.raw_recording import robust_deviation
from buggy_rl.recordings.stamps import Jump, unwound

RATES = 4.0, 1100.0  # [Hz] that a unit of time must give to be plausible; loggers of cars
NAMES = re.compile(r"time|stamp|(^|[^a-z])t($|[^a-z])|sec|clock", re.IGNORECASE)
GAP = 3.0  # [median periods] a step above it is a gap
BILLION = 1e9  # nanoseconds in a second
JUMPS = 0.01  # share of the steps at which a clock may have been set
ORDERED = 0.5  # share of the steps that go up, from which a column may be a clock that stood still


@dataclass(frozen=True)
class RowStamps:
    """Stamps of T rows."""

    columns: dict[str, str]
    """Column -> unit; several add up."""
    t: ndarray
    """[T] s, without the jumps of a clock that was set."""
    evidence: str
    jumps: list[Jump] = field(default_factory=list)
    """Jumps at which the clock was set."""

    @property
    def period(self) -> float:
        """Median step [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def jitter(self) -> float:
        """Robust standard deviation of the steps, in periods."""
        return robust_deviation(np.abs(np.diff(self.t) / self.period - 1))

    @property
    def gaps(self) -> ndarray:
        """Lengths [n] of the steps that are gaps [s]."""
        step = np.diff(self.t)
        return step[step > GAP * self.period]

    @property
    def seconds(self) -> float:
        """Time from the first stamp to the last [s]."""
        return float(self.t[-1] - self.t[0])


def find_clock(columns: Mapping[str, ndarray]) -> RowStamps | None:
    """The most plausible stamps among the numeric columns [T] of a table; None if there are none.

    Seconds and nanoseconds in two columns add up. Otherwise it is a column that increases strictly,
    but for jumps of a clock that was set, with a unit that gives a plausible rate; a telling name
    decides between several.
    """
    pair = _seconds_and_nanoseconds(columns)
    if pair is not None:
        return pair
    found = []
    for name, values in columns.items():
        step = np.diff(values)
        if not np.isfinite(values).all() or not (step > 0).mean() > 1 - JUMPS:
            continue
        for unit, factor in UNITS["t"].items():
            rate = 1 / (factor * float(np.median(step)))
            t, _ = unwound(factor * values)
            if RATES[0] <= rate <= RATES[1] and (np.diff(t) > 0).all():
                told = bool(NAMES.search(name))
                found.append((told, -abs(np.log(rate / 100)), name, unit, rate))
                break
    if not found:
        return None
    _, _, name, unit, rate = max(found)
    t, jumps = unwound(UNITS["t"][unit] * columns[name])
    evidence = f"strictly increasing{_but(jumps)}; in {unit} the rows come at {rate:.4g} Hz"
    return RowStamps({name: unit}, t, evidence, jumps)


def _but(jumps: list[Jump]) -> str:
    return "".join(f", but {jump} at row {jump.row}" for jump in jumps)


def why_no_clock(columns: Mapping[str, ndarray]) -> str:
    """Why none of the numeric columns [T] of a table is a time stamp, and which comes nearest."""
    text = "no column is a time stamp: none increases strictly"
    rising = {name: float((np.diff(values) > 0).mean()) for name, values in columns.items()}
    rising = {n: s for n, s in rising.items() if s > ORDERED or (NAMES.search(n) and s > 0)}
    if not rising:
        return text
    name = max(rising, key=lambda n: (bool(NAMES.search(n)), rising[n]))
    if rising[name] == 1:
        rate = 1 / float(np.median(np.diff(columns[name])))
        return (
            f"no column is a time stamp: {name} increases, but in none of {', '.join(UNITS['t'])} "
            f"do rows come at {RATES[0]:g} to {RATES[1]:g} Hz (in s: {rate:.3g} Hz)"
        )
    bad = int(np.argmax(~(np.diff(columns[name]) > 0))) + 1
    share = f"{1 - rising[name]:.1%} of its steps, first at row {bad}, do not"
    return f"{text}; {name} comes nearest, {share}"


def _seconds_and_nanoseconds(columns: Mapping[str, ndarray]) -> RowStamps | None:
    whole = [n for n, v in columns.items() if (v == np.floor(v)).all()]
    for seconds in whole:
        step = np.diff(columns[seconds])
        named = NAMES.search(seconds) or seconds == "s" or seconds.isdigit()
        if (step < 0).mean() > JUMPS or not named:
            continue
        for parts in whole:
            values = columns[parts]
            if values.min() < 0 or not 0.5 * BILLION < values.max() < BILLION:
                continue
            t, jumps = unwound(columns[seconds] + values / BILLION)
            if (np.diff(t) > 0).all():
                evidence = f"{parts} runs through 0 to 1e9 while {seconds} goes up by ones"
                return RowStamps({seconds: "s", parts: "ns"}, t, evidence + _but(jumps), jumps)
    return None
