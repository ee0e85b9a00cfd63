"""Rows of several sources in one table, with empty cells between: merged by time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import BESIDE, COMMANDS, UNITS, ColumnMap, SourceTable
from buggy_rl.recordings.readers.csv_parquet import read_csv, read_json_lines, read_parquet
from buggy_rl.recordings.readers.layout import Table
from buggy_rl.recordings.recording import Limits, RecordingError
from buggy_rl.recordings.stamps import unwound


def last_before(stamps: ndarray, values: ndarray, at: ndarray) -> ndarray:
    """Values at or before times [N]; before the first stamp, where `near` is false, the first."""
    return values[np.maximum(np.searchsorted(stamps, at, side="right") - 1, 0)]


def interpolated(
    channel: str, stamps: ndarray, values: ndarray, at: ndarray, turn: float = 2 * np.pi
) -> ndarray:
    """Values [N] between neighbours in time, linear; a yaw is not interpolated across its wrap.

    Args:
        channel: `yaw`, or another.
        stamps: [T] s, increasing.
        values: [T].
        at: [N] s.
        turn: A whole turn in the unit of a yaw.
    """
    if channel == "yaw":
        values = np.unwrap(values, period=turn)
    return np.interp(at, stamps, values)


def near(stamps: ndarray, at: ndarray, hold: float, last: bool) -> ndarray:
    """Whether times [N] have a stamp within `hold` [s] before them and, unless `last`, after."""
    index = np.searchsorted(stamps, at, side="right")
    before = np.where(index > 0, at - stamps[np.maximum(index - 1, 0)], np.inf)
    after = np.where(index < len(stamps), stamps[np.minimum(index, len(stamps) - 1)] - at, np.inf)
    return (before <= hold) & (last | (before == 0) | (after <= hold))


POSITION = ("x", "y")
SCATTERED = 3.0  # [median intervals] an interval without a value that is no hole in a source
ENCLOSED = 0.5  # share of the empty cells in shorter intervals where a column has its own rows
CHANGING = 0.9  # share of values that differ from the one before: written only when they change
TOLD = 0.25  # [s] a command that is held for longer is told of; radios repeat theirs at 10 Hz


@dataclass(frozen=True)
class _Source:
    """The rows of a table in which one column has a value."""

    channel: str
    column: str
    values: ndarray
    """[T], NaN where the cell is empty."""

    @property
    def known(self) -> ndarray:
        """[T] bool."""
        return ~np.isnan(self.values)

    def has_own_rows(self, t: ndarray, commands: ndarray) -> bool:
        """Whether its empty cells are rows of another source, or values that did not change.

        Args:
            t: [T] s.
            commands: [T, C] the commands; they are written together.
        """
        known = self.known
        interval = np.diff(t[known])
        if len(interval) < 2:
            return False
        limit = SCATTERED * float(np.median(interval))
        stamps = t[known]
        after = np.searchsorted(stamps, t[~known], side="right")
        inner = (after > 0) & (after < len(stamps))
        length = np.full(len(after), np.inf)
        length[inner] = stamps[after[inner]] - stamps[after[inner] - 1]
        if (length <= limit).mean() > ENCLOSED:
            return True
        if self.channel not in COMMANDS:
            return False
        lengths = np.bincount(after[after > 0])  # rows of each run of empty cells
        if not len(lengths) or lengths.max() > ENCLOSED * lengths.sum():
            return False  # lost for a while
        written = commands[known]
        return bool((np.diff(written, axis=0) != 0).any(-1).mean() > CHANGING)


def merged_by_time(
    table: Table, names: Mapping[str, str], t: ndarray, limits: Limits, turn: float = 2 * np.pi
) -> Table:
    """Merges the rows of several sources onto those of the position.

    Commands are held until their next value; everything else is interpolated linearly between
    neighbours in time, where both are within `command_hold`. A table in which no column of the map
    lacks more than `missing_share` of its cells is returned as it is.

    Args:
        table: With empty cells.
        names: Channel -> column, of those that are read, without the time.
        t: [T] s.
        limits: `missing_share` and `command_hold`.
        turn: A whole turn in the unit of the yaw.
    """
    sources = [_Source(channel, name, table.numbers(name)) for channel, name in names.items()]
    sparse = [s for s in sources if 1 > (~s.known).mean() > limits.missing_share]
    if not sparse or not np.isfinite(t).all():
        return table
    order = np.argsort(t, kind="stable")  # tables may stand below one another
    sparse = [_Source(s.channel, s.column, s.values[order]) for s in sparse]
    t_sorted = t[order]
    commands = np.stack([s.values[order] for s in sources if s.channel in COMMANDS[:2]], -1)
    own = [s for s in sparse if s.has_own_rows(t_sorted, commands)]
    if not own:
        return table
    rows, kept = _kept_rows(own, t_sorted)
    for source in own:
        if source.channel in COMMANDS:
            kept &= np.cumsum(source.known) > 0
    index = np.flatnonzero(kept)
    result = Table(
        table.file,
        {name: values[order][index] for name, values in table.columns.items()},
        dict(table.labels),
        [*table.notes, _note(own, rows, table)],
        rows=table.file_rows[order][index],
        headerless=table.headerless,
    )
    at = t_sorted[index]
    for source in own:
        result.columns[source.column] = _at(source, t_sorted, at, limits.command_hold, turn)
    result.notes += _held(own, t_sorted, result)
    return result


def _kept_rows(own: Sequence[_Source], t: ndarray) -> tuple[str, ndarray]:
    """What the rows of the result are, and which [T] they are."""
    position = [source.known for source in own if source.channel in POSITION]
    if not position:
        return "all rows", np.ones(len(t), bool)
    return "the rows of the position", np.logical_and.reduce(position)


def _at(source: _Source, t: ndarray, at: ndarray, hold: float, turn: float) -> ndarray:
    """Values [n] of a source at times [n]."""
    stamps, values = t[source.known], source.values[source.known]
    if source.channel in COMMANDS:
        return last_before(stamps, values, at)
    there = near(stamps, at, hold, last=False)
    return np.where(there, interpolated(source.channel, stamps, values, at, turn), np.nan)


def _note(own: Sequence[_Source], rows: str, table: Table) -> str:
    shares: dict[str, list[str]] = {}
    for source in own:
        shares.setdefault(f"{source.known.mean():.0%}", []).append(table.label(source.column))
    told = "; ".join(f"{', '.join(names)} in {share}" for share, names in shares.items())
    how = "commands held until their next value"
    if any(source.channel not in (*COMMANDS, *POSITION) for source in own):
        how += ", all else interpolated"
    return f"values in some of the rows only ({told}): merged by time onto {rows}, {how}"


def _held(own: Sequence[_Source], t: ndarray, table: Table) -> list[str]:
    """The longest time that each command was held, where that is longer than radios repeat it."""
    longest: dict[tuple[float, float], list[str]] = {}
    for source in own:
        stamps = t[source.known]
        if source.channel in COMMANDS and len(stamps) > 1:
            at = int(np.argmax(np.diff(stamps)))
            held = float(stamps[at]), float(stamps[at + 1] - stamps[at])
            longest.setdefault(held, []).append(table.label(source.column))
    return [
        f"column {', '.join(names)}: held for up to {seconds:.3g} s, from t = {begin:.3f} s on"
        for (begin, seconds), names in longest.items()
        if seconds > TOLD
    ]


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
