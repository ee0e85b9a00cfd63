"""From checked rows at the file's rate to a recording on a uniform grid."""

import numpy as np
from numpy import ndarray
from scipy.interpolate import Akima1DInterpolator
from scipy.signal import savgol_filter

from buggy_rl.recordings.columns import ColumnMap
from buggy_rl.recordings.drive import Drive, turn

SNAP = 1e-6  # [s] a stamp this close to the grid is on it: CSV files round, clocks do not
ORDER = 3  # of the smoother's polynomial: follows a change of acceleration
ROWS = 5  # that the smoother spans at least, at the file's own rate


def resample(drive: Drive, columns: ColumnMap, dt: float) -> dict[str, ndarray]:
    """Puts every stretch on a grid of `dt` and derives what velocities are missing.

    Pose: Akima's cubic (modified), which does not overshoot; velocities: linear; commands: the
    last value at or before the grid time. Nothing is carried across a gap, and a cut always
    leaves at least one grid row out, so that a saved drive still shows it.

    Returns:
        Arrays `t` [N, 1], `pose` [N, 3], `velocity` [N, 3], `action` [N, 2], `segment` [N].
    """
    stretches = drive.stretches()
    origin = float(drive.t[stretches[0][0]])
    window = _window(drive, columns, dt)
    parts, last = [], -1
    for stretch in stretches:
        part, last = _part(drive, columns, stretch, origin, last, dt, window)
        if part is not None:
            parts += _where_commanded(drive, columns, part)
    _note_derived(drive, columns, window, dt)
    shortest = round(columns.limits.shortest_segment / dt)
    kept = [part for part in parts if len(part["t"]) >= max(shortest, 2)]
    _note_dropped(drive, parts, kept, dt)
    for number, part in enumerate(kept):
        part["segment"] = np.full(len(part["t"]), number, np.int64)
    return {key: np.concatenate([part[key] for part in kept]) for key in kept[0]} if kept else {}


def _window(drive: Drive, columns: ColumnMap, dt: float) -> int:
    """Rows of the smoother on the grid, odd and more than its order."""
    seconds = max(columns.smoothing_window, ROWS * drive.period)
    return max(round(seconds / dt) | 1, ORDER + 2)


def _part(drive, columns, stretch: ndarray, origin: float, last: int, dt: float, window: int):
    """One stretch on the grid, and the number of its last grid row."""
    stamps = drive.t[stretch]
    first = int(np.ceil((stamps[0] - origin - SNAP) / dt))
    first = max(first, last + 2) if last >= 0 else first  # a cut costs a row
    final = int(np.floor((stamps[-1] - origin + SNAP) / dt))
    if final - first + 1 < 2 or len(stretch) < 2:
        return None, last
    t = _snapped(origin + dt * np.arange(first, final + 1), stamps)
    yaw = np.unwrap(drive.pose[stretch, 2])
    pose = np.column_stack([drive.pose[stretch, :2], yaw])
    pose = _smooth_curve(stamps - origin, pose, t - origin)
    velocity = _velocity(drive, columns, stretch, pose, t, dt, window)
    return {"t": t[:, None], "pose": pose, "velocity": velocity}, final


def _snapped(grid: ndarray, stamps: ndarray) -> ndarray:
    """The grid, with rows that coincide with a stamp at exactly that stamp."""
    right = np.clip(np.searchsorted(stamps, grid), 1, len(stamps) - 1)
    left = stamps[right - 1]
    nearest = np.where(grid - left < stamps[right] - grid, left, stamps[right])
    return np.where(np.abs(grid - nearest) <= SNAP, nearest, grid)


def _smooth_curve(stamps: ndarray, values: ndarray, t: ndarray) -> ndarray:
    if len(stamps) < 3:
        return np.column_stack([np.interp(t, stamps, column) for column in values.T])
    return np.asarray(Akima1DInterpolator(stamps, values, method="makima")(t))


def _velocity(drive, columns, stretch, pose, t, dt, window) -> ndarray:
    """vx, vy, yaw rate [N, 3]: the file's own where it has them, else derived from the pose."""
    velocity = _derived(pose, dt, window)
    if drive.linear is not None and not columns.derive_velocity:
        for axis in (0, 1):
            velocity[:, axis] = np.interp(t, drive.t[stretch], drive.linear[stretch, axis])
    if drive.yaw_rate is not None and not columns.derive_velocity:
        velocity[:, 2] = np.interp(t, drive.t[stretch], drive.yaw_rate[stretch])
    return velocity


def _derived(pose: ndarray, dt: float, window: int) -> ndarray:
    """Body-frame velocity [N, 3]: R(-yaw) d/dt (x, y) and d/dt yaw, by Savitzky and Golay."""
    rows = min(window, len(pose) if len(pose) % 2 else len(pose) - 1)
    order = min(ORDER, rows - 1)
    rate = np.asarray(savgol_filter(pose, rows, order, deriv=1, delta=dt, axis=0))
    yaw = np.asarray(savgol_filter(pose[:, 2], rows, order))
    return np.column_stack([turn(rate[:, :2], -yaw), rate[:, 2]])


def _where_commanded(drive: Drive, columns: ColumnMap, part: dict[str, ndarray]) -> list[dict]:
    """Adds the commands, and splits where there is none that is recent enough."""
    t = part["t"][:, 0]
    stamps = drive.t + columns.command_offset
    latest = np.searchsorted(stamps, t + SNAP, side="right") - 1
    hold = max(columns.limits.command_hold, drive.longest_step)
    known = (latest >= 0) & (t - stamps[np.maximum(latest, 0)] <= hold)
    part["action"] = drive.action[np.maximum(latest, 0)]
    if known.all():
        return [part]
    drive.notes.append(
        f"column {drive.label('throttle')!r}: no command within {hold:.3g} s before "
        f"{(~known).sum()} rows from t = {t[np.argmin(known)]:.3f} s on: cut"
    )
    edges = np.flatnonzero(np.diff(known.astype(int))) + 1
    runs = np.split(np.arange(len(t)), edges)
    return [{key: part[key][run] for key in part} for run in runs if known[run[0]]]


def _note_derived(drive: Drive, columns: ColumnMap, window: int, dt: float) -> None:
    names = [] if drive.linear is not None and not columns.derive_velocity else ["vx", "vy"]
    if drive.yaw_rate is None or columns.derive_velocity:
        names.append("yaw_rate")
    if names:
        drive.notes.append(
            f"{', '.join(names)} derived from the pose: Savitzky-Golay, order {ORDER}, "
            f"{window} rows ({window * dt:.3g} s, half of it ahead)"
        )


def _note_dropped(drive: Drive, parts: list[dict], kept: list[dict], dt: float) -> None:
    dropped = [part for part in parts if not any(part is other for other in kept)]
    if dropped:
        seconds = sum(len(part["t"]) for part in dropped) * dt
        starts = ", ".join(f"{part['t'][0, 0]:.3f}" for part in dropped[:5])
        more = " ..." if len(dropped) > 5 else ""
        drive.notes.append(
            f"{len(dropped)} stretches too short to use, {seconds:.2f} s in all, dropped: "
            f"from t = {starts}{more} s"
        )
