"""Checks of cells: missing values, infinities, leaps, positions that are no lengths."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.ndimage import median_filter

from buggy_rl.recordings.checks.sensor import SPEED_WINDOW, speed_beside
from buggy_rl.recordings.raw_recording import RawRecording, robust_deviation, wrap_angles
from buggy_rl.recordings.recording import Limits, RecordingError

NEVER_MISSING = ("t", "throttle", "steering")
"""Channels of the logger itself; only a tracker can lose the car."""


def check_cells(
    file: str, raw: Mapping[str, ndarray], labels: Mapping[str, str], row: ndarray, limits: Limits
) -> dict[str, ndarray]:
    """Returns the missing cells [T] of the tracker's channels, few enough to be cut.

    Raises:
        RecordingError: An infinity, a missing time or command, or too many missing cells.
    """
    missing = {}
    for channel, values in raw.items():
        infinite, blank = np.isinf(values), np.isnan(values)
        if infinite.any():
            at = int(np.argmax(infinite))
            message = f"{values[at]}; correct the value or delete the row"
            raise RecordingError(file, message, int(row[at]), labels[channel])
        if not blank.any():
            continue
        first = int(row[np.argmax(blank)])
        if channel in NEVER_MISSING:
            rows = "delete the row" if blank.sum() == 1 else f"delete these {blank.sum()} rows"
            raise RecordingError(file, f"no value (NaN); {rows}", first, labels[channel])
        if blank.mean() > limits.missing_share:
            message = (
                f"no value (NaN) in {blank.mean():.0%} of the rows exceeds missing_share "
                f"{limits.missing_share:.0%}; state limits: {{missing_share: "
                f"{np.ceil(100 * blank.mean()) / 100:g}}} in a column map to cut these rows, or "
                "record again"
            )
            raise RecordingError(file, message, first, labels[channel])
        missing[channel] = blank
    return missing


METRES = 111_195.0  # [m] in a degree of a great circle, of a sphere of 6371 km
CHORD = 0.5  # [s] over which a speed is taken; a receiver with 7 decimals has steps of 1 cm
FARTHEST = 180.0, 90.0  # [degrees] of longitude and latitude
STILL = 0.1  # of `moving_speed`: slower than that in metres, it is not driven; chosen
ALIKE = 0.35  # relative difference of two speeds that are the same; the scale of a sensor is off
FOLLOWS = 0.7  # concentration of course minus heading of a car: 45 degrees of sideslip
DRIVEN = 0.1  # share of the rows that move, in metres, where degrees are driven over; chosen


def check_geographic(raw: RawRecording, limits: Limits) -> None:
    """Positions are in metres, not in degrees of longitude and latitude.

    Raises:
        RecordingError: As metres the car stands still; as degrees it drives, along its heading or
            as fast as its measured velocity says.
    """
    count = raw.rows(CHORD)
    rows = np.flatnonzero(raw.keep & np.isfinite(raw.pose[:, :2]).all(-1))
    if len(rows) <= count:
        return
    xy, t = raw.pose[rows, :2], raw.t[rows]
    if (np.abs(xy).max(0) > FARTHEST).any() and (np.abs(xy[:, ::-1]).max(0) > FARTHEST).any():
        return
    moved = (xy[count:] - xy[:-count]) / (t[count:] - t[:-count])[:, None]
    if np.linalg.norm(moved, axis=-1).max() > STILL * limits.moving_speed:
        return
    latitude = 0 if np.abs(xy[:, 1]).max() > FARTHEST[1] else 1  # its column
    velocity = moved * METRES
    velocity[:, 1 - latitude] *= np.cos(np.radians(np.median(xy[:, latitude])))
    speed = np.linalg.norm(velocity, axis=-1)
    driven = speed > limits.moving_speed
    if driven.mean() < DRIVEN or np.quantile(speed, 0.9) > limits.top_speed:
        return
    middle = rows[count // 2 : count // 2 + len(velocity)]
    if _as_measured(raw, middle, speed) or _follows(velocity[driven], raw.pose[middle[driven], 2]):
        message = (
            f"({xy[0, 0]:.6f}, {xy[0, 1]:.6f}) looks like longitude and latitude in degrees: as "
            f"metres the car stands still, as degrees it drives at {np.median(speed):.2g} m/s; "
            f"project them, for example x = {METRES:.0f} cos(latitude) (longitude "
            f"{-xy[0, 1 - latitude]:+.4f}), y = {METRES:.0f} (latitude {-xy[0, latitude]:+.4f})"
        )
        raise raw.error(int(rows[0]), "x", message)


def _as_measured(raw: RawRecording, rows: ndarray, speed: ndarray) -> bool:
    """Whether speeds [n] at rows [n] are those of the measured velocity."""
    if raw.linear is None:
        return False
    measured = np.linalg.norm(raw.linear[rows], axis=-1)
    return bool(np.median(np.abs(speed - measured)) < ALIKE * np.median(speed))


def _follows(velocity: ndarray, yaw: ndarray) -> bool:
    """Whether a heading [n], of any unit, sign and origin, is that of a velocity [n, 2]."""
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    off = [course - sign * unit * yaw for sign in (1, -1) for unit in (1.0, np.radians(1.0))]
    concentration = max(float(np.abs(np.exp(1j * angle).mean())) for angle in off)
    return concentration > FOLLOWS


STANDING = 3.0  # divides `moving_speed` to 0.1 m/s: a tracker at rest stays below it


@dataclass(frozen=True)
class _Steps:
    """Steps between kept neighbours of one channel, n of them."""

    rows: ndarray
    """[n + 1] the kept rows."""
    size: ndarray
    """[n, C] m or rad."""
    time: ndarray
    """[n] s."""
    median: ndarray
    """[n, C] m/s or rad/s, median rate around the step."""
    excess: ndarray
    """[n] |size - median time|."""
    bound: ndarray
    """[n] largest excess of a step that is no leap."""


def check_leaps(raw: RawRecording, limits: Limits) -> None:
    """Cuts glitches (the pose leaps and returns) and ends a segment at a teleport.

    A step is a leap if |step - median step| > leap + a w dt + sigmas * sigma, with w the half
    window and sigma the robust standard deviation of the recording's steps.
    """
    channels = (
        ("x", "m", limits.leap, limits.leap_acceleration),
        ("yaw", "rad", limits.leap_yaw, limits.leap_yaw_acceleration),
    )
    for channel, unit, granted, acceleration in channels:
        steps = _steps(raw, channel, granted, acceleration, limits)
        if steps is not None:
            teleports = _cut_glitches(raw, channel, steps, limits)
            _split_at(raw, channel, unit, steps, teleports, limits)


def _steps(
    raw: RawRecording, channel: str, granted: float, acceleration: float, limits: Limits
) -> _Steps | None:
    rows = np.flatnonzero(raw.keep)
    half = raw.rows(limits.leap_window, 2)
    if len(rows) <= 2 * half + 1:
        return None
    size = np.diff(raw.pose[rows], axis=0)
    size = size[:, :2] if channel == "x" else wrap_angles(size[:, 2:])
    time = np.diff(raw.t[rows])
    median = median_filter(size / time[:, None], size=(2 * half + 1, 1), mode="nearest")
    excess = np.linalg.norm(size - median * time[:, None], axis=-1)
    reach = acceleration * half * raw.period * time
    bound = granted + reach + limits.leap_sigmas * robust_deviation(excess)
    return _Steps(rows, size, time, median, excess, bound)


def _cut_glitches(raw: RawRecording, channel: str, steps: _Steps, limits: Limits) -> list[int]:
    """Cuts the leaps that return; returns the steps that do not."""
    leaps = np.flatnonzero((steps.excess > steps.bound) & (steps.time <= raw.longest_step))
    glitch = np.zeros(len(raw.t), bool)
    teleports = []
    index = 0
    while index < len(leaps):
        first = int(leaps[index])
        back = _return(steps, first, leaps[index + 1 :], limits.glitch_duration)
        if back is None:
            teleports.append(first)
            index += 1
        else:
            glitch[steps.rows[first + 1 : back + 1]] = True
            index = int(np.searchsorted(leaps, back, side="right"))
    raw.cut(glitch, channel, "glitch, the pose leaps and returns")
    return teleports


def _return(steps: _Steps, first: int, later: ndarray, duration: float) -> int | None:
    """The leap that returns the pose to where step `first` would have led, or None."""
    for back in later:
        span = slice(first, int(back) + 1)
        if steps.time[first + 1 : int(back) + 1].sum() > duration:
            return None
        off = (steps.size[span] - steps.median[first] * steps.time[span, None]).sum(0)
        if np.linalg.norm(off) < steps.bound[first] + steps.bound[back]:
            return int(back)
    return None


def _split_at(
    raw: RawRecording, channel: str, unit: str, steps: _Steps, teleports: list[int], limits: Limits
) -> None:
    if not teleports:
        return
    rows = steps.rows[np.array(teleports) + 1]
    raw.starts[rows] = True
    size = steps.excess[teleports].max()
    raw.note(rows, channel, f"teleport, the pose leaps by up to {size:.3g} {unit}: cut before it")
    if channel == "x":
        lost = np.zeros(len(raw.t), bool)
        for row in rows:
            lost |= _lost_after(raw, int(row), limits)
        raw.cut(lost, channel, "stands still after a teleport at speed, the tracker lost the car")


def _lost_after(raw: RawRecording, row: int, limits: Limits) -> ndarray:
    """Rows [T] from a teleport to the next motion, if the car moved before and not after."""
    lost = np.zeros(len(raw.t), bool)
    slow = limits.moving_speed / STANDING
    if speed_beside(raw, row - 1, -1) < limits.moving_speed or speed_beside(raw, row, 1) > slow:
        return lost
    count = raw.rows(SPEED_WINDOW)
    ahead = raw.pose[row + count :, :2] - raw.pose[row:-count, :2]
    speed = np.linalg.norm(ahead, axis=-1) / (raw.t[row + count :] - raw.t[row:-count])
    moves = np.flatnonzero(speed > slow)
    lost[row : row + moves[0] if len(moves) else None] = True
    return lost
