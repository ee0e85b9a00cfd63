"""Rows of several sources in one table, with empty cells between: merged by time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import COMMANDS
from buggy_rl.recordings.limits import Limits
from buggy_rl.recordings.readers.neighbours import interpolated, last_before, near
from buggy_rl.recordings.readers.table import Table

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
