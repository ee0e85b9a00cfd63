"""The drives of a folder, unconverted: one table each, or several tables in a folder of its own."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import ColumnMap
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers import Table, is_recording, read

TABLES = (".csv", ".parquet")
FULL = 0.9  # share of numbers in a column that is read as it is
LEAST = 50  # numbers of a column with blanks, for anything to be seen in it


@dataclass(frozen=True)
class RawDrive:
    """One drive as its files have it."""

    name: str
    tables: dict[str, Table]
    """By the file's name without its ending; an only table by "", so that drives compare."""
    files: dict[str, str]
    """The same names -> names of the files."""

    @property
    def several(self) -> bool:
        """Whether the drive is spread over several tables."""
        return len(self.tables) > 1


def numbers(table: Table) -> dict[str, ndarray]:
    """Columns [T] of numbers, as float64; blanks are NaN. Text is left out: a frame's name."""
    found = {}
    for name in table.columns:
        try:
            values = table.numbers(name)
        except RecordingError:
            continue
        if np.isfinite(values).any():
            found[name] = values
    return found


def numeric_columns(table: Table) -> dict[str, ndarray]:
    """Columns [T] of numbers that change and are finite in nine rows of ten, as float64."""
    return {
        name: values
        for name, values in numbers(table).items()
        if np.isfinite(values).mean() >= FULL and changes(values)
    }


def filled(table: Table, t: ndarray) -> dict[str, ndarray]:
    """Columns [T] that change and have blanks, interpolated over the stamps [T].

    Rows of several sources in one table, such as a pose and the commands, leave one another blank.
    """
    found = {}
    for name, values in numbers(table).items():
        known = np.isfinite(values)
        if LEAST <= known.sum() < FULL * len(values) and changes(values):
            found[name] = np.interp(t, t[known], values[known])
    return found


def changes(values: ndarray) -> bool:
    """Whether a column [T] has different numbers."""
    finite = values[np.isfinite(values)]
    return len(finite) > 2 and bool(finite.min() < finite.max())


def find_drives(folder: Path) -> Iterator[tuple[str, list[Path]]]:
    """Name and files of every drive in a folder and below.

    Tables of one folder with different headers are those of one drive.

    Raises:
        ValueError: There is no such folder.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder; name one with recordings in it")
    if is_recording(folder):  # arrays, or a ROS 2 bag
        yield folder.name, [folder]
        return
    entries = [e for e in sorted(folder.iterdir()) if not e.name.startswith(".")]
    tables = [e for e in entries if e.is_file() and e.suffix.lower() in TABLES]
    if len({_header(file) for file in tables}) > 1:
        yield folder.name, tables
        tables = []
    others = [e for e in entries if e.is_file() and e.suffix.lower() not in TABLES]
    for file in (*tables, *(e for e in others if is_recording(e))):
        yield file.stem, [file]
    for entry in entries:
        if entry.is_dir():
            yield from find_drives(entry)


def read_drive(name: str, files: list[Path]) -> RawDrive:
    """Reads the tables of a drive.

    Raises:
        RecordingError: One cannot be read.
    """
    keys = [""] if len(files) == 1 else [file.stem for file in files]
    tables = {key: read(file, ColumnMap()) for key, file in zip(keys, files, strict=True)}
    return RawDrive(name, tables, dict(zip(keys, (file.name for file in files), strict=True)))


def qualified(table: str, column: str) -> str:
    """A column's name in a column map: `table.column`, or the column of an only table."""
    return f"{table}.{column}" if table else column


def _header(file: Path) -> bytes:
    """First line of a CSV file; the whole name for others, whose columns need a library to read."""
    if file.suffix.lower() != ".csv":
        return str(file).encode()
    with file.open("rb") as stream:
        return stream.readline().strip()
