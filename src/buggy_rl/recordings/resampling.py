"""Resamples checked rows to a uniform grid, and filters recorded velocities."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from numpy import ndarray
from scipy.interpolate import Akima1DInterpolator
from scipy.ndimage import maximum_filter1d
from scipy.signal import savgol_filter
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.recordings.columns import ColumnMap
from buggy_rl.recordings.raw_recording import RawRecording, rotate_rows
from buggy_rl.recordings.recording import Recording

SNAP = 1e-6  # [s] a stamp this close to the grid is on it; CSV files round to microseconds
BRIDGED = 0.1  # [s] longest gap over which a sensor beside the tracker is read: 10 Hz; chosen
ORDER = 3  # of the Savitzky-Golay polynomial: follows a changing acceleration
LEAST_ROWS = 5  # of the file, spanned by the Savitzky-Golay window: 2 more than its order

Arrays = dict[str, ndarray]
"""`t` [N, 1], `pose` [N, 3], `velocity` [N, 3], `action` [N, 2], `segment` [N] on the grid.

Sensors beside the tracker, where there are any, are [N, 1] each.
"""


@dataclass(frozen=True)
class _Grid:
    """Times origin + k dt, and the window of the Savitzky-Golay filter on it."""

    origin: float
    dt: float
    window: int
    """Rows, odd."""


def resample(raw: RawRecording, columns: ColumnMap, dt: float) -> Arrays:
    """Resamples every segment to the period `dt` and derives the missing velocities.

    Pose: modified Akima cubic, which does not overshoot. Velocity: linear. Command: the last one
    at or before the grid time. Nothing is interpolated across a gap, and a cut always omits at
    least one grid row, so that it is preserved in a saved file.
    """
    segments = raw.segments()
    seconds = max(columns.smoothing_window, LEAST_ROWS * raw.period)
    window = max(round(seconds / dt) | 1, ORDER + 2)
    grid = _Grid(float(raw.t[segments[0][0]]), dt, window)
    parts, last = [], -1
    for segment in segments:
        part, last = _resampled(raw, columns, grid, segment, last)
        if part is not None:
            slow = _below_top_speed(raw, columns, grid, part)
            parts += [piece for each in slow for piece in _with_commands(raw, columns, each)]
    _note_derived(raw, columns, grid)
    shortest = max(round(columns.limits.shortest_segment / dt), 2)
    kept = [part for part in parts if len(part["t"]) >= shortest]
    _note_dropped(raw, [part["t"] for part in parts if len(part["t"]) < shortest], dt)
    for number, part in enumerate(kept):
        part["segment"] = np.full(len(part["t"]), number, np.int64)
    return {key: np.concatenate([part[key] for part in kept]) for key in kept[0]} if kept else {}


def _resampled(
    raw: RawRecording, columns: ColumnMap, grid: _Grid, segment: ndarray, last: int
) -> tuple[Arrays | None, int]:
    """One segment on the grid after grid row `last`, and its own last grid row."""
    stamps, origin, dt = raw.t[segment], grid.origin, grid.dt
    first = int(np.ceil((stamps[0] - origin - SNAP) / dt))
    first = max(first, last + 2) if last >= 0 else first  # a cut omits a row
    final = int(np.floor((stamps[-1] - origin + SNAP) / dt))
    if final - first + 1 < 2 or len(segment) < 2:
        return None, last
    t = _snapped(origin + dt * np.arange(first, final + 1), stamps)
    pose = np.column_stack([raw.pose[segment, :2], np.unwrap(raw.pose[segment, 2])])
    pose = _interpolated(stamps - origin, pose, t - origin)
    velocity = _derived(pose, grid)
    if raw.linear is not None:
        for axis in (0, 1):
            velocity[:, axis] = np.interp(t, stamps, raw.linear[segment, axis])
    if raw.yaw_rate is not None:
        velocity[:, 2] = np.interp(t, stamps, raw.yaw_rate[segment])
    beside = {key: _beside(raw, values, t)[:, None] for key, values in raw.beside.items()}
    return {"t": t[:, None], "pose": pose, "velocity": velocity, **beside}, final


def _beside(raw: RawRecording, values: ndarray, t: ndarray) -> ndarray:
    """A sensor beside the tracker [N], linear; NaN in gaps longer than `BRIDGED`.

    It keeps its values where the tracker has lost the car.
    """
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(t), np.nan)
    stamps = raw.t[known]
    left = np.clip(np.searchsorted(stamps, t + SNAP, side="right") - 1, 0, len(stamps) - 1)
    right = np.clip(np.searchsorted(stamps, t - SNAP), 0, len(stamps) - 1)
    inside = (stamps[left] <= t + SNAP) & (stamps[right] >= t - SNAP)
    bridged = inside & (stamps[right] - stamps[left] <= BRIDGED)
    return np.where(bridged, np.interp(t, stamps, values[known]), np.nan)


def _snapped(grid: ndarray, stamps: ndarray) -> ndarray:
    """Grid times, replaced by a stamp where one coincides."""
    right = np.clip(np.searchsorted(stamps, grid), 1, len(stamps) - 1)
    left = stamps[right - 1]
    nearest = np.where(grid - left < stamps[right] - grid, left, stamps[right])
    snapped = np.where(np.abs(grid - nearest) <= SNAP, nearest, grid)
    # By rounding, a grid time that is exactly SNAP before the first stamp may not be snapped to it.
    return np.clip(snapped, stamps[0], stamps[-1])


def _interpolated(stamps: ndarray, values: ndarray, t: ndarray) -> ndarray:
    if len(stamps) < 3:
        return np.column_stack([np.interp(t, stamps, column) for column in values.T])
    return np.asarray(Akima1DInterpolator(stamps, values, method="makima")(t))


def _derived(pose: ndarray, grid: _Grid) -> ndarray:
    """Body-frame velocity [N, 3]: R(-yaw) d/dt (x, y) and d/dt yaw, by Savitzky-Golay."""
    rows = min(grid.window, len(pose) if len(pose) % 2 else len(pose) - 1)
    order = min(ORDER, rows - 1)
    rate = np.asarray(savgol_filter(pose, rows, order, deriv=1, delta=grid.dt, axis=0))
    yaw = np.asarray(savgol_filter(pose[:, 2], rows, order))
    return np.column_stack([rotate_rows(rate[:, :2], -yaw), rate[:, 2]])


def _below_top_speed(
    raw: RawRecording, columns: ColumnMap, grid: _Grid, part: Arrays
) -> list[Arrays]:
    """Splits where the speed exceeds `top_speed`, half a filter window on each side included.

    The quantile that refuses a recording lets single leaps through: those of a noisy tracker
    survive the check of leaps, which grants them its noise.
    """
    speed, most = np.linalg.norm(part["velocity"][:, :2], axis=-1), columns.limits.top_speed
    if speed.max() <= most:
        return [part]
    slow = np.asarray(maximum_filter1d(speed > most, grid.window)) == 0
    t, at = part["t"][:, 0], int(np.argmax(speed))
    raw.note_column(
        "x",
        f"{speed[at]:.3g} m/s at t = {t[at]:.3f} s exceeds top_speed {most:g} m/s, as do "
        f"{(speed > most).sum() - 1} further rows of this segment: cut, with "
        f"{(grid.window // 2) * grid.dt:.2g} s on each side",
    )
    return _runs_of(part, slow)


def _runs_of(part: Arrays, wanted: ndarray) -> list[Arrays]:
    """The runs of rows [N] that are wanted."""
    edges = np.flatnonzero(np.diff(wanted.astype(int))) + 1
    runs = np.split(np.arange(len(wanted)), edges)
    return [{key: values[run] for key, values in part.items()} for run in runs if wanted[run[0]]]


def _with_commands(raw: RawRecording, columns: ColumnMap, part: Arrays) -> list[Arrays]:
    """Adds the commands, and splits where none is recent enough."""
    t = part["t"][:, 0]
    stamps = raw.t + columns.command_offset
    latest = np.searchsorted(stamps, t + SNAP, side="right") - 1
    hold = max(columns.limits.command_hold, raw.longest_step)
    known = (latest >= 0) & (t - stamps[np.maximum(latest, 0)] <= hold)
    part["action"] = raw.action[np.maximum(latest, 0)]
    if known.all():
        return [part]
    raw.note_column(
        "throttle",
        f"no command within {hold:.3g} s before {(~known).sum()} rows from "
        f"t = {t[np.argmin(known)]:.3f} s on: cut",
    )
    return _runs_of(part, known)


def _note_derived(raw: RawRecording, columns: ColumnMap, grid: _Grid) -> None:
    names = [] if raw.linear is not None else ["vx", "vy"]
    if raw.yaw_rate is None:
        names.append("yaw_rate")
    raw.derived = tuple(names)
    if names:
        raw.notes.append(
            f"{', '.join(names)} derived from the pose: Savitzky-Golay, order {ORDER}, "
            f"{grid.window} rows ({grid.window * grid.dt:.3g} s, half of it ahead)"
        )


def _note_dropped(raw: RawRecording, dropped: list[ndarray], dt: float) -> None:
    if dropped:
        starts = ", ".join(f"{t[0, 0]:.3f}" for t in dropped[:5])
        more = " ..." if len(dropped) > 5 else ""
        raw.notes.append(
            f"{len(dropped)} segments too short to use, {sum(map(len, dropped)) * dt:.2f} s in "
            f"all, dropped: from t = {starts}{more} s"
        )


Preparation = Literal["raw", "filtered", "mirrored"]
"""`filtered`: causal mean of the velocities; `mirrored`: filtered, plus the left/right mirror."""


def past_mean(signal: Tensor, width: int) -> Tensor:
    """Causal mean of the last `width` rows of a signal [T, C], the present one included.

    y_t = (x_{t-width+1} + ... + x_t) / width; the first rows average the rows there are.
    """
    total = torch.cumsum(signal.double(), 0)
    shifted = torch.zeros_like(total)
    shifted[width:] = total[:-width]
    count = torch.arange(1, len(signal) + 1, device=signal.device).clamp_max(width)
    return ((total - shifted) / count[:, None]).to(signal.dtype)


def local_parabola(signal: Tensor, width: int) -> Tensor:
    """Savitzky-Golay filter of second order: preserves slope and curvature. Not causal.

    A signal [T, C] of fewer than `width` rows is returned unchanged.

    Raises:
        ValueError: The width is even.
    """
    if width % 2 == 0:
        raise ValueError(f"local_parabola: width is {width} rows; use an odd number")
    if len(signal) < width:
        return signal.clone()
    return torch.as_tensor(savgol_filter(signal.numpy(), width, 2, axis=0), dtype=signal.dtype)


def filtered(
    recording: Recording, width: int, smoother: Callable[[Tensor, int], Tensor] = past_mean
) -> Recording:
    """Returns a copy of the recording with its velocities filtered segment by segment."""
    data = recording.data.clone()
    for segment in data[keys.SEGMENT].unique():
        rows = data[keys.SEGMENT] == segment
        data[keys.VELOCITY][rows] = smoother(data[keys.VELOCITY][rows], width)
    notes = [*recording.notes, f"velocities: {smoother.__name__} over {width} rows"]
    return replace(recording, data=data, notes=notes)
