"""A folder of recordings: facts of every drive, what they share, what they lack."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.columns import Guess, exchanged
from buggy_rl.inspection.coverage import (
    Coverage,
    command_coverage,
    drive_suggestions,
    missing_in_files,
)
from buggy_rl.inspection.drive import DriveFacts, inspect_drive
from buggy_rl.inspection.proposal import EXCHANGED, chosen_commands, proposal
from buggy_rl.inspection.signals import changes, find_drives, number_columns, qualified

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
        """Says all facts of the column in words."""
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
        for column, values in number_columns(table).items():
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


Found = tuple[str, list[Path]]


@dataclass(frozen=True)
class InspectConfig:
    """A folder to look into."""

    output: str = ""
    """Folder for inspection.html, inspection.png and columns.yaml; empty for runs/inspection."""
    most: int = 0
    """Look at so many drives only, spread over the folder; 0 for all."""


@dataclass(frozen=True)
class Inspection:
    """What was found in a folder."""

    folder: str
    drives: list[DriveFacts]
    commands: dict[str, Guess]
    """Channel -> the column that most drives agree on."""
    seen: Coverage
    missing: list[str]
    """What the files lack, one line each."""
    suggestions: list[str]
    """What to drive next, one line each."""
    proposal: str
    """A column map to be edited."""
    first: list[str]
    """What to know before anything else, one line each."""
    columns: list[ColumnFacts]
    """Every numeric column of the longest drive."""


def inspect_folder(
    folder: Path, most: int = 0, progress: Callable[[list[Found]], Iterable[Found]] = iter
) -> Inspection:
    """Reads all drives of a folder unconverted and says what they hold.

    Args:
        folder: With recordings, or folders of them.
        most: Drives to look at, spread over the folder; 0 for all.
        progress: Wraps the list of drives while they are read, e.g. `tqdm`.

    Raises:
        ValueError: There is no such folder, or no recording in it.
    """
    found = list(find_drives(folder))
    if not found:
        raise ValueError(f"{folder}: no recording below it; expected .csv, .parquet, .npy or a bag")
    if 0 < most < len(found):
        found = [found[round(i * (len(found) - 1) / max(most - 1, 1))] for i in range(most)]
    drives = [inspect_drive(name, files) for name, files in progress(found)]
    commands = chosen_commands(drives)
    seen = command_coverage(drives, commands)
    return Inspection(
        str(folder),
        drives,
        commands,
        seen,
        missing_in_files(drives, commands),
        list(drive_suggestions(seen, len(drives))),
        proposal(drives, commands),
        [EXCHANGED] if exchanged(commands) else [],
        listing(_longest(drives)),
    )


def _longest(drives: list[DriveFacts]) -> DriveFacts:
    """The drive with the longest pose, or without any the one with the most rows."""

    def length(drive: DriveFacts) -> tuple[float, int]:
        rows = max(map(len, drive.raw.tables.values()), default=0) if drive.raw else 0
        return (drive.pose.clock.seconds if drive.pose else 0.0), rows

    return max(drives, key=length)
