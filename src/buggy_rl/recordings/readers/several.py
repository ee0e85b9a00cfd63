"""One drive in several tables of one folder, each with its own time stamps, merged into one."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import BESIDE, COMMANDS, UNITS, ColumnMap, SourceTable
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.readers.csv_parquet import read_csv, read_parquet
from buggy_rl.recordings.readers.json_lines import read_json_lines
from buggy_rl.recordings.readers.neighbours import interpolated, last_before, near
from buggy_rl.recordings.readers.table import Table
from buggy_rl.recordings.stamps import unwound

TABLES = {
    **{".csv": read_csv, ".tsv": read_csv, ".parquet": read_parquet},
    **{".jsonl": read_json_lines, ".ndjson": read_json_lines},
}
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
    parts, stamps, notes = {}, {}, []
    for source in columns.tables:
        stem, table = Path(source.file).stem, _read(folder / source.file)
        parts[stem], stamps[stem] = _stamped(table, source)
        notes += [f"{source.file}: {note}" for note in parts[stem].notes]
    first = Path(columns.tables[0].file).stem
    at, hold = stamps[first], columns.limits.command_hold
    turn = 360.0 if columns.units.get("yaw") == "deg" else 2 * np.pi
    kept = np.ones(len(at), bool)
    merged: dict[str, ndarray] = {columns.names.get("t", "t"): at}
    for channel, name in _wanted(columns, parts).items():
        stem, _, column = name.partition(".")
        if column not in parts[stem].columns:
            raise _missing(parts[stem], column)
        values = parts[stem].numbers(column)
        if stem == first:
            merged[name] = values
            continue
        last = channel in COMMANDS
        merged[name] = (
            last_before(stamps[stem], values, at)
            if last
            else interpolated(channel, stamps[stem], values, at, turn)
        )
        there = near(stamps[stem], at, hold, last)
        if channel in BESIDE:
            merged[name] = np.where(there, merged[name], np.nan)
        else:
            kept &= there
    whole = Table(str(folder), merged, notes=notes, starts=parts[first].starts)
    return _kept(whole, kept, hold, parts[first].file_rows)


def _read(file: Path) -> Table:
    if not file.is_file():
        there = ", ".join(sorted(f.name for f in file.parent.iterdir() if f.is_file()))
        raise RecordingError(str(file), f"no such file; available: {there}")
    if file.suffix.lower() not in TABLES:
        raise RecordingError(str(file), f"ending {file.suffix!r}; use {' or '.join(TABLES)}")
    return TABLES[file.suffix.lower()](file)


def _missing(table: Table, column: str) -> RecordingError:
    there = ", ".join(table.columns)
    if table.headerless:
        there = f"no header line, columns by their position: 0 to {len(table.columns) - 1}"
    return RecordingError(table.file, f"missing; available: {there}", column=column)


def _stamped(table: Table, source: SourceTable) -> tuple[Table, ndarray]:
    """A table without the rows that it repeats, and their stamps [T] s.

    The stamps are the sum of its time columns, without the jumps of a clock that was set.
    """
    missing = [name for name in source.time if name not in table.columns]
    if missing:
        raise _missing(table, ", ".join(missing))
    t = sum(UNITS["t"][unit] * table.numbers(name) for name, unit in source.time.items())
    t = np.asarray(t, float)
    again = _repeats(table, t)
    if again.any():
        table, t = table.take(np.flatnonzero(~again)), t[~again]
        table.notes.append(f"{int(again.sum())} rows repeat the row before them: left out")
    if np.isfinite(t).all():
        t, jumps = unwound(t)
        at = [jump.row for jump in jumps]
        table.starts = np.union1d(table.starts, at).astype(int)
        rows = table.file_rows
        table.notes += [f"row {rows[j.row]}: {j}: two segments: cut there" for j in jumps]
    bad = ~np.isfinite(t)
    bad[1:] |= ~(np.diff(t) > 0)
    if bad.any():
        at, column = int(np.argmax(bad)), ", ".join(source.time)
        message = (
            f"time {t[at]:.6f} s is not after that of the row before ({int(bad.sum())} such rows); "
            "delete the row, or sort the table by its stamps"
        )
        raise RecordingError(table.file, message, int(table.file_rows[at]), column)
    return table, t


def _repeats(table: Table, t: ndarray) -> ndarray:
    """[T] bool: rows whose stamp and cells are those of the row before."""
    again = np.zeros(len(t), bool)
    again[1:] = np.diff(t) == 0
    for values in table.columns.values() if again.any() else ():
        text = values.astype(str)
        again[1:] &= text[1:] == text[:-1]
    return again


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


def _kept(table: Table, near: ndarray, hold: float, rows: ndarray) -> Table:
    """The rows that all tables have values for.

    Args:
        table: Merged.
        near: [T] bool, those rows.
        hold: Longest time to another table's row [s].
        rows: [T] row in the first file.
    """
    table.rows = rows
    if near.all():
        return table
    if not near.any():
        message = f"no row has all of the other tables within {hold:g} s; check their clocks"
        raise RecordingError(table.file, message, column="t")
    lost = int((~near).sum())
    note = f"{lost} rows of the first table have no value of another within {hold:g} s: cut"
    kept = table.take(np.flatnonzero(near))
    kept.notes.append(note)
    return kept
