"""Check for leaps of the pose: glitches return, teleports do not."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.ndimage import median_filter

from buggy_rl.recordings.checks.sensor import SPEED_WINDOW, speed_beside
from buggy_rl.recordings.limits import Limits
from buggy_rl.recordings.raw_recording import RawRecording, robust_deviation, wrap_angle

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
    size = size[:, :2] if channel == "x" else wrap_angle(size[:, 2:])
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
