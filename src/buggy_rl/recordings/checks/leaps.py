"""Poses that leap: glitches that come back, teleports that do not."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.ndimage import median_filter

from buggy_rl.recordings.checks.sensor import BEFORE, speed_beside
from buggy_rl.recordings.drive import Drive, wrap
from buggy_rl.recordings.limits import Limits


@dataclass(frozen=True)
class _Steps:
    """Steps between kept neighbours of one channel, n of them."""

    rows: ndarray
    """[n + 1] the kept rows."""
    size: ndarray
    """[n, C] m or rad."""
    time: ndarray
    """[n] s."""
    usual: ndarray
    """[n, C] m/s or rad/s, the median around it."""
    excess: ndarray
    """[n] |size - usual time|."""
    bound: ndarray
    """[n] what is granted."""


def check_leaps(drive: Drive, limits: Limits) -> None:
    """Cuts glitches (the pose leaps and comes back) and ends a stretch at teleports.

    A row leaps when |step - median step around it| > leap + a w dt + sigmas * spread, with w the
    half window and spread the drive's own.
    """
    channels = (
        ("x", "m", limits.leap, limits.leap_acceleration),
        ("yaw", "rad", limits.leap_yaw, limits.leap_yaw_acceleration),
    )
    for channel, unit, floor, acceleration in channels:
        steps = _steps(drive, channel, floor, acceleration, limits)
        if steps is not None:
            teleports = _cut_glitches(drive, channel, steps, limits)
            _split_at(drive, channel, unit, steps, teleports, limits)


def _steps(
    drive: Drive, channel: str, floor: float, acceleration: float, limits: Limits
) -> _Steps | None:
    rows = np.flatnonzero(drive.keep)
    half = max(2, round(limits.leap_window / drive.period))
    if len(rows) <= 2 * half + 1:
        return None
    size = np.diff(drive.pose[rows], axis=0)
    size = size[:, :2] if channel == "x" else wrap(size[:, 2:])
    time = np.diff(drive.t[rows])
    usual = median_filter(size / time[:, None], size=(2 * half + 1, 1), mode="nearest")
    excess = np.linalg.norm(size - usual * time[:, None], axis=-1)
    spread = 1.4826 * np.median(excess)
    reach = acceleration * half * drive.period * time
    return _Steps(rows, size, time, usual, excess, floor + reach + limits.leap_sigmas * spread)


def _cut_glitches(drive: Drive, channel: str, steps: _Steps, limits: Limits) -> list[int]:
    """Cuts what leaps and comes back; returns the steps that do not."""
    leaps = np.flatnonzero((steps.excess > steps.bound) & (steps.time <= drive.longest_step))
    glitch = np.zeros(len(drive.t), bool)
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
    drive.cut(glitch, channel, "glitch, the pose leaps and comes back")
    return teleports


def _return(steps: _Steps, first: int, later: ndarray, duration: float) -> int | None:
    """The leap that brings the pose back to where step `first` would have led, if one does."""
    for back in later:
        span = slice(first, int(back) + 1)
        if steps.time[first + 1 : int(back) + 1].sum() > duration:
            return None
        off = (steps.size[span] - steps.usual[first] * steps.time[span, None]).sum(0)
        if np.linalg.norm(off) < steps.bound[first] + steps.bound[back]:
            return int(back)
    return None


def _split_at(
    drive: Drive, channel: str, unit: str, steps: _Steps, teleports: list[int], limits: Limits
) -> None:
    if not teleports:
        return
    rows = steps.rows[np.array(teleports) + 1]
    drive.starts[rows] = True
    size = steps.excess[teleports].max()
    drive.note(rows, channel, f"teleport, the pose leaps by up to {size:.3g} {unit}: cut before it")
    if channel == "x":
        lost = np.zeros(len(drive.t), bool)
        for row in rows:
            lost |= _lost_after(drive, int(row), limits)
        drive.cut(lost, channel, "stands still after a teleport at speed, the car was lost")


def _lost_after(drive: Drive, row: int, limits: Limits) -> ndarray:
    """Rows [T] from a teleport until the car moves again, if it moved before and not after."""
    lost = np.zeros(len(drive.t), bool)
    slow = limits.moving_speed / 3
    if speed_beside(drive, row - 1, -1) < limits.moving_speed or speed_beside(drive, row, 1) > slow:
        return lost
    count = max(1, round(BEFORE / drive.period))
    ahead = drive.pose[row + count :, :2] - drive.pose[row:-count, :2]
    speed = np.linalg.norm(ahead, axis=-1) / (drive.t[row + count :] - drive.t[row:-count])
    moves = np.flatnonzero(speed > slow)
    lost[row : row + moves[0] if len(moves) else None] = True
    return lost
