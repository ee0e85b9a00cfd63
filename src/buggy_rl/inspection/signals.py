"""The raw tables of a drive as columns on one even grid, and how they go with the motion."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.clock import RowStamps
from buggy_rl.inspection.motion import MOVING, Pose
from buggy_rl.recordings.columns import ColumnMap
from buggy_rl.recordings.readers import Table, is_recording, read
from buggy_rl.recordings.recording import RecordingError

TABLES = (".csv", ".parquet")
FULL = 0.9  # share of numbers in a column that is read as it is
LEAST = 50  # numbers of a column with blanks, for anything to be seen in it


@dataclass(frozen=True)
class RawDrive:
    """One drive as its files have it."""

    name: str
    tables: dict[str, Table]
    """Tables by the file's name without its ending; an only table by "", so that drives compare."""
    files: dict[str, str]
    """The same names -> names of the files."""

    @property
    def several(self) -> bool:
        """Whether the drive is spread over several tables."""
        return len(self.tables) > 1


def number_columns(table: Table) -> dict[str, ndarray]:
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
        for name, values in number_columns(table).items()
        if np.isfinite(values).mean() >= FULL and changes(values)
    }


def filled(table: Table, t: ndarray) -> dict[str, ndarray]:
    """Columns [T] that change and have blanks, interpolated over the stamps [T].

    Rows of several sources in one table, such as a pose and the commands, leave one another blank.
    """
    found = {}
    for name, values in number_columns(table).items():
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


STEP = 0.02  # [s] of the grid; delays are seen to half of it
HOLE = 0.3  # [s] without a pose above which the grid's rows are left out
LONGEST_LAG = 0.6  # [s] from a command to what it does
EARLIEST = -0.1  # [s] by which a measurement may come before the pose that shows the same
LEAST_ROWS = 100  # 2 s of the grid, for a correlation
OUTLIERS = 0.01, 0.99  # quantiles that a signal is clipped to before it is correlated; chosen
CREEP = 0.5  # [m/s] added to a speed that a yaw rate is divided by


@dataclass(frozen=True)
class DriveSignals:
    """Motion and columns of a drive at N instants, `STEP` apart."""

    t: ndarray
    """[N] s since the first pose."""
    known: ndarray
    """[N] whether a pose is near."""
    xy: ndarray
    """[N, 2] m."""
    speed: ndarray
    """[N] along the heading [m/s]."""
    yaw_rate: ndarray
    """[N] rad/s."""
    columns: dict[str, ndarray]
    """`table.column`, or the column of an only table -> [N], the last value at each instant."""

    @property
    def acceleration(self) -> ndarray:
        """[N] along the heading [m/s^2]."""
        return np.gradient(self.speed, STEP)

    @property
    def curvature(self) -> ndarray:
        """[N] of the path [1/m]; damped at a crawl."""
        return self.yaw_rate * self.speed / (self.speed**2 + CREEP**2)

    @property
    def moving(self) -> ndarray:
        """[N] whether the car moves and its pose is known."""
        return self.known & (np.abs(self.speed) > MOVING)


@dataclass(frozen=True)
class ColumnResponse:
    """How a column goes with a signal of the motion."""

    column: str
    correlation: float
    lag: float
    """Time by which the signal follows the column [s]."""
    slope: float
    """Change of the column's values per unit of the signal, at that lag."""
    offset: float
    """Value of the column where the signal is zero."""


def make_signals(
    pose: Pose, tables: Mapping[str, Mapping[str, ndarray]], clocks: Mapping[str, RowStamps]
) -> DriveSignals:
    """Puts a pose and all other numeric columns on one grid.

    Args:
        pose: The motion.
        tables: Table -> column -> values [T].
        clocks: Of the tables; those without one are left out.
    """
    at = np.arange(pose.clock.t[0], pose.clock.t[-1], STEP)
    nearest = np.searchsorted(pose.clock.t, at, side="right").clip(1, len(pose.clock.t) - 1)
    hole = pose.clock.t[nearest] - pose.clock.t[nearest - 1] > HOLE
    used = set(pose.names.values())
    columns = {}
    for table, clock in clocks.items():
        for name, values in tables[table].items():
            counts = bool((np.diff(values) >= 0).all())  # a clock or a counter
            if name in clock.columns or counts or (table == pose.table and name in used):
                continue
            columns[qualified(table, name)] = _held(clock.t, values, at)

    def even(values: ndarray) -> ndarray:
        return np.interp(at, pose.clock.t, values)

    xy = np.stack([even(pose.xy[:, 0]), even(pose.xy[:, 1])], -1)
    speed, rate = even(pose.speed), even(pose.yaw_rate)
    return DriveSignals(at - at[0], ~hole, xy, speed, rate, columns)


def responses(
    signals: DriveSignals, signal: ndarray, rows: ndarray, earliest: float
) -> list[ColumnResponse]:
    """How each column goes with a signal [N] over some rows [N], the best correlation first.

    Args:
        signals: The columns.
        signal: What they are compared with.
        rows: Which instants count.
        earliest: Least lag tried [s].
    """
    found = [column_response(signals, name, signal, rows, earliest) for name in signals.columns]
    known = [r for r in found if r is not None]
    return sorted(known, key=lambda r: -abs(r.correlation))


def column_response(
    signals: DriveSignals, column: str, signal: ndarray, rows: ndarray, earliest: float = 0.0
) -> ColumnResponse | None:
    """How one column goes with a signal [N]; None where too little of it changes."""
    values, signal = signals.columns[column], clipped(signal, rows)
    lags, found = lagged_correlations(values, signal, rows, earliest)
    if not np.isfinite(found).any():
        return None
    at = int(np.nanargmax(np.abs(found)))
    earlier, good = _earlier(values, int(lags[at]), rows)
    slope, offset = np.polyfit(signal[good], earlier[good], 1)
    return ColumnResponse(
        column, float(found[at]), float(lags[at]) * STEP, float(slope), float(offset)
    )


def clipped(signal: ndarray, rows: ndarray) -> ndarray:
    """A signal [N] without outliers: a noisy tracker's derivative has many times the speed."""
    return np.clip(signal, *np.quantile(signal[rows], OUTLIERS)) if rows.any() else signal


def lagged_correlations(
    values: ndarray, signal: ndarray, rows: ndarray, earliest: float = 0.0
) -> tuple[ndarray, ndarray]:
    """Lags [L] in steps, and the correlation [L] of values [N] with a signal [N] that much later.

    NaN where too few rows are left or nothing changes.
    """
    lags = np.arange(round(earliest / STEP), round(LONGEST_LAG / STEP) + 1)
    return lags, np.array([_correlation(values, signal, int(lag), rows) for lag in lags])


def _correlation(values: ndarray, signal: ndarray, lag: int, rows: ndarray) -> float:
    earlier, good = _earlier(values, lag, rows)
    if good.sum() < LEAST_ROWS or np.ptp(earlier[good]) == 0 or np.ptp(signal[good]) == 0:
        return float("nan")
    return float(np.corrcoef(earlier[good], signal[good])[0, 1])


def _earlier(values: ndarray, lag: int, rows: ndarray) -> tuple[ndarray, ndarray]:
    """Values [N] `lag` steps earlier, and the rows [N] that have one."""
    earlier = np.roll(values, lag)
    good = rows & np.isfinite(earlier)
    good[slice(0, lag) if lag >= 0 else slice(lag, None)] = False
    return earlier, good


def _held(stamps: ndarray, values: ndarray, at: ndarray) -> ndarray:
    """The last values at or before times [N]; NaN before the first."""
    index = np.searchsorted(stamps, at, side="right") - 1
    return np.where(index >= 0, values[np.maximum(index, 0)], np.nan)
