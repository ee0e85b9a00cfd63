"""One drive in several tables of one folder, each with its own time stamps, merged into one."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import BESIDE, COMMANDS, UNITS, ColumnMap, SourceTable
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.csv_parquet import read_csv, read_parquet
from buggy_rl.recordings.readers.table import Table

TABLES = {".csv": read_csv, ".parquet": read_parquet}
"""Ending of a file -> its reader."""


def holds_tables(folder: Path, tables: Sequence[SourceTable]) -> bool:
    """Whether a folder has one of the files, so that it is meant to be one drive."""
    return folder.is_dir() and any((folder / table.file).is_file() for table in tables)


def read_several(folder: Path, columns: ColumnMap) -> Table:
    """Merges the tables of a column map onto the stamps of the first.

    A command is the last one at or before a stamp; everything else is interpolated linearly
    between its neighbours in time. Stamps without a command, or beyond `command_hold` from a
    neighbour, are left out and noted: nothing is filled in, the gap stays one.

    Args:
        folder: Of the drive.
        columns: With `tables`, and names of the form `file.column`, without the file's ending.

    Raises:
        RecordingError: A file or column is missing, or stamps run back.
    """
    parts = {Path(t.file).stem: _read(folder / t.file) for t in columns.tables}
    stamps = {Path(t.file).stem: _stamps(parts[Path(t.file).stem], t) for t in columns.tables}
    first = Path(columns.tables[0].file).stem
    at, hold = stamps[first], columns.limits.command_hold
    near = np.ones(len(at), bool)
    merged: dict[str, ndarray] = {columns.names.get("t", "t"): at}
    for channel, name in _wanted(columns, parts).items():
        stem, _, column = name.partition(".")
        if column not in parts[stem].columns:
            there = ", ".join(parts[stem].columns)
            raise RecordingError(parts[stem].file, f"missing; available: {there}", column=column)
        values = parts[stem].numbers(column)
        if stem == first:
            merged[name] = values
            continue
        if channel in BESIDE:
            there = _near(stamps[stem], at, hold, False)
            merged[name] = np.where(there, np.interp(at, stamps[stem], values), np.nan)
            continue
        last = channel in COMMANDS
        merged[name] = (
            _last(stamps[stem], values, at) if last else np.interp(at, stamps[stem], values)
        )
        near &= _near(stamps[stem], at, hold, last)
    return _kept(Table(str(folder), merged), near, hold)


def _read(file: Path) -> Table:
    if not file.is_file():
        there = ", ".join(sorted(f.name for f in file.parent.iterdir() if f.is_file()))
        raise RecordingError(str(file), f"no such file; available: {there}")
    if file.suffix.lower() not in TABLES:
        raise RecordingError(str(file), f"ending {file.suffix!r}; use {' or '.join(TABLES)}")
    return TABLES[file.suffix.lower()](file)


def _stamps(table: Table, source: SourceTable) -> ndarray:
    """Stamps [T] s of a table: the sum of its time columns."""
    missing = [name for name in source.time if name not in table.columns]
    if missing:
        there = ", ".join(table.columns)
        raise RecordingError(table.file, f"missing; available: {there}", column=", ".join(missing))
    t = sum(UNITS["t"][unit] * table.numbers(name) for name, unit in source.time.items())
    t = np.asarray(t, float)
    bad = ~np.isfinite(t)
    bad[1:] |= ~(np.diff(t) > 0)
    if bad.any():
        at, column = int(np.argmax(bad)), ", ".join(source.time)
        message = f"time {t[at]:.6f} s is not after that of the row before; delete the row"
        raise RecordingError(table.file, message, at, column)
    return t


def _wanted(columns: ColumnMap, parts: Mapping[str, Table]) -> dict[str, str]:
    """Channel -> `file.column` of the map's names, time excluded."""
    wanted = {c: n for c, n in columns.names.items() if c != "t" and n not in columns.ignore}
    if columns.throttle.factor:
        wanted["throttle factor"] = columns.throttle.factor
    for channel, name in wanted.items():
        if name.partition(".")[0] not in parts:
            raise ValueError(
                f"names: {channel} is {name!r}; with several tables write file.column, with one "
                f"of {', '.join(parts)} for file"
            )
    return wanted


def _last(stamps: ndarray, values: ndarray, at: ndarray) -> ndarray:
    """Values at or before times [N]; before the first stamp, where `_near` is false, the first."""
    return values[np.maximum(np.searchsorted(stamps, at, side="right") - 1, 0)]


def _near(stamps: ndarray, at: ndarray, hold: float, last: bool) -> ndarray:
    """Whether times [N] have a stamp within `hold` [s] before them and, unless `last`, after."""
    index = np.searchsorted(stamps, at, side="right")
    before = np.where(index > 0, at - stamps[np.maximum(index - 1, 0)], np.inf)
    after = np.where(index < len(stamps), stamps[np.minimum(index, len(stamps) - 1)] - at, np.inf)
    return (before <= hold) & (last | (before == 0) | (after <= hold))


def _kept(table: Table, near: ndarray, hold: float) -> Table:
    """The rows that all tables have values for."""
    if near.all():
        return table
    if not near.any():
        message = f"no row has all of the other tables within {hold:g} s; check their clocks"
        raise RecordingError(table.file, message, column="t")
    lost = int((~near).sum())
    note = f"{lost} rows of the first table have no value of another within {hold:g} s: cut"
    columns = {name: values[near] for name, values in table.columns.items()}
    return replace(table, columns=columns, notes=[note], rows=np.flatnonzero(near))
