"""All columns of a drive beside its motion, on one even grid, and how they go with it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.clock import Clock
from buggy_rl.inspection.motion import MOVING, Pose
from buggy_rl.inspection.raw_drive import qualified

STEP = 0.02  # [s] of the grid; delays are seen to half of it
HOLE = 0.3  # [s] without a pose above which the grid's rows are left out
LONGEST_LAG = 0.6  # [s] from a command to what it does
EARLIEST = -0.1  # [s] by which a measurement may come before the pose that shows the same
LEAST_ROWS = 100  # 2 s of the grid, for a correlation
OUTLIERS = 0.01, 0.99  # quantiles that a signal is clipped to before it is correlated; chosen
CREEP = 0.5  # [m/s] added to a speed that a yaw rate is divided by


@dataclass(frozen=True)
class Signals:
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
class Response:
    """How a column goes with a signal of the motion."""

    column: str
    correlation: float
    lag: float
    """By which the signal follows the column [s]."""
    slope: float
    """Of the column's values per unit of the signal, at that lag."""
    offset: float
    """Of the column where the signal is zero."""


def make_signals(
    pose: Pose, tables: Mapping[str, Mapping[str, ndarray]], clocks: Mapping[str, Clock]
) -> Signals:
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
    return Signals(at - at[0], ~hole, xy, speed, rate, columns)


def responses(signals: Signals, signal: ndarray, rows: ndarray, earliest: float) -> list[Response]:
    """How each column goes with a signal [N] over some rows [N], the best correlation first.

    Args:
        signals: The columns.
        signal: What they are compared with.
        rows: Which instants count.
        earliest: Least lag tried [s].
    """
    found = [response(signals, name, signal, rows, earliest) for name in signals.columns]
    known = [r for r in found if r is not None]
    return sorted(known, key=lambda r: -abs(r.correlation))


def response(
    signals: Signals, column: str, signal: ndarray, rows: ndarray, earliest: float = 0.0
) -> Response | None:
    """How one column goes with a signal [N]; None where too little of it changes."""
    values, signal = signals.columns[column], clipped(signal, rows)
    lags, found = correlations(values, signal, rows, earliest)
    if not np.isfinite(found).any():
        return None
    at = int(np.nanargmax(np.abs(found)))
    earlier, good = _earlier(values, int(lags[at]), rows)
    slope, offset = np.polyfit(signal[good], earlier[good], 1)
    return Response(column, float(found[at]), float(lags[at]) * STEP, float(slope), float(offset))


def clipped(signal: ndarray, rows: ndarray) -> ndarray:
    """A signal [N] without outliers: a noisy tracker's derivative has many times the speed."""
    return np.clip(signal, *np.quantile(signal[rows], OUTLIERS)) if rows.any() else signal


def correlations(
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
