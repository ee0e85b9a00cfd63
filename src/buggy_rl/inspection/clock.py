"""The time stamps of a table: which columns they are, and how regular."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import UNITS
from buggy_rl.recordings.raw_recording import robust_deviation

RATES = 4.0, 1100.0  # [Hz] that a unit of time must give to be plausible; loggers of cars
NAMES = re.compile(r"time|stamp|(^|[^a-z])t($|[^a-z])|sec|clock", re.IGNORECASE)
GAP = 3.0  # [median periods] a step above it is a gap
BILLION = 1e9  # nanoseconds in a second


@dataclass(frozen=True)
class Clock:
    """Stamps of T rows."""

    columns: dict[str, str]
    """Column -> unit; several add up."""
    t: ndarray
    """[T] s."""
    evidence: str

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
        """From the first stamp to the last [s]."""
        return float(self.t[-1] - self.t[0])


def find_clock(columns: Mapping[str, ndarray]) -> Clock | None:
    """The most plausible stamps among the numeric columns [T] of a table; None if there are none.

    Seconds and nanoseconds in two columns add up. Otherwise it is a strictly increasing column
    with a unit that gives a plausible rate; a telling name decides between several.
    """
    pair = _seconds_and_nanoseconds(columns)
    if pair is not None:
        return pair
    found = []
    for name, values in columns.items():
        step = np.diff(values)
        if not (step > 0).all():
            continue
        for unit, factor in UNITS["t"].items():
            rate = 1 / (factor * float(np.median(step)))
            if RATES[0] <= rate <= RATES[1]:
                told = bool(NAMES.search(name))
                found.append((told, -abs(np.log(rate / 100)), name, unit, rate))
                break
    if not found:
        return None
    _, _, name, unit, rate = max(found)
    evidence = f"strictly increasing; in {unit} the rows come at {rate:.4g} Hz"
    return Clock({name: unit}, UNITS["t"][unit] * columns[name], evidence)


def _seconds_and_nanoseconds(columns: Mapping[str, ndarray]) -> Clock | None:
    whole = [n for n, v in columns.items() if (v == np.floor(v)).all()]
    for seconds in whole:
        step = np.diff(columns[seconds])
        if (step < 0).any() or (not NAMES.search(seconds) and seconds != "s"):
            continue
        for parts in whole:
            values = columns[parts]
            if values.min() < 0 or not 0.5 * BILLION < values.max() < BILLION:
                continue
            t = columns[seconds] + values / BILLION
            if (np.diff(t) > 0).all():
                evidence = f"{parts} runs through 0 to 1e9 while {seconds} goes up by ones"
                return Clock({seconds: "s", parts: "ns"}, t, evidence)
    return None
