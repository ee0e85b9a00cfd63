"""Every numeric column of a drive: range, rate, share of blanks, and what it may be."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.drive import DriveFacts
from buggy_rl.inspection.raw_drive import changes, numbers, qualified

WRAP = 0.8  # of a turn, by which a heading leaps where it is wrapped
PULSE = 800.0, 2300.0  # [us] of servos and speed controllers
MOST = 100  # columns that are listed of a drive


@dataclass(frozen=True)
class ColumnFacts:
    """One column, T rows."""

    name: str
    """`table.column`."""
    low: float
    high: float
    rate: float
    """[Hz] at which its value changes, or of a table without stamps its changes a row."""
    blank: float
    """Share of rows without a number."""
    guess: str
    """What it is, or may be; empty where nothing is known."""

    def line(self) -> str:
        """All of it in words."""
        blank = f", {self.blank:.0%} blank" if self.blank else ""
        guess = f": {self.guess}" if self.guess else ""
        return f"{self.name}: {self.low:.5g} to {self.high:.5g}, {self.rate:.3g} Hz{blank}{guess}"


def listing(drive: DriveFacts) -> list[ColumnFacts]:
    """Facts of the numeric columns of a drive, in the order of its files."""
    if drive.raw is None:
        return []
    known = dict(_known(drive))
    found = []
    for key, table in drive.raw.tables.items():
        clock = drive.clocks.get(key)
        seconds = clock.seconds if clock is not None else float(len(table))
        for column, values in numbers(table).items():
            finite = values[np.isfinite(values)]
            name = qualified(key, column)
            changed = int((np.diff(finite) != 0).sum())
            found.append(
                ColumnFacts(
                    name,
                    float(finite.min()),
                    float(finite.max()),
                    changed / max(seconds, 1e-9),
                    1 - len(finite) / len(values),
                    known.get(name) or _guess(finite),
                )
            )
    return found[:MOST]


def _known(drive: DriveFacts) -> Iterator[tuple[str, str]]:
    """What was found, by column; the less certain first."""
    for rate, guesses in drive.rates.items():
        for guess in guesses:
            yield guess.column, f"{rate} [{guess.unit}]"
    for key, clock in drive.clocks.items():
        for column, unit in clock.columns.items():
            yield qualified(key, column), f"time [{unit}]"
    for channel in ("steering", "throttle"):
        guess = getattr(drive, channel)
        if guess is not None:
            yield guess.column, channel
    if drive.pose is not None:
        for channel, column in drive.pose.names.items():
            yield qualified(drive.pose.table, column), channel


def _guess(values: ndarray) -> str:
    """What a column's numbers [n], finite, may be by themselves."""
    if not changes(values):
        return "constant"
    low, high, different = float(values.min()), float(values.max()), len(np.unique(values))
    if different == 2:
        return "a switch"
    step = np.diff(values)
    if (step >= 0).all():
        return "a clock or a counter"
    leap = float(np.abs(step).max())
    for turn, unit in ((2 * np.pi, "rad"), (360.0, "deg")):
        if leap > WRAP * turn and high - low <= 1.05 * turn:
            return f"a heading in {unit}, wrapped"
    if PULSE[0] <= low and high <= PULSE[1] and (values == np.round(values)).mean() > 0.5:
        return "a pulse of a servo or speed controller [us]"
    if np.abs(values).max() <= 1:
        return "within -1 and 1: a command, or part of a quaternion"
    return ""
