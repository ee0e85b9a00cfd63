"""Time stamps: order, rate, bunches and gaps."""

import numpy as np

from buggy_rl.recordings.drive import Drive
from buggy_rl.recordings.limits import Limits


def check_order(drive: Drive, limits: Limits) -> None:
    """Time strictly increases.

    Raises:
        RecordingError: It runs back or stands still, or there are too few rows to tell.
    """
    if len(drive.t) < 3:
        raise drive.refusal(
            len(drive.t) - 1, "t", f"the drive has {len(drive.t)} rows", "record a longer one"
        )
    step = np.diff(drive.t)
    if (step > 0).all():
        return
    at = int(np.argmax(step <= 0)) + 1
    does = "stands still" if step[at - 1] == 0 else f"runs back by {-step[at - 1]:.6g} s"
    count = int((step <= 0).sum())
    raise drive.refusal(
        *(at, "t", f"time {does} at {drive.t[at]:.6f} s ({count} such rows)"),
        "delete the rows, or stamp on measurement instead of on delivery",
    )


def check_rate(drive: Drive, limits: Limits) -> None:
    """The nominal rate is high enough.

    Raises:
        RecordingError: It is below `slowest_rate`.
    """
    if drive.period * limits.slowest_rate > 1.01:  # 1 % for clocks that run slow
        raise drive.refusal(
            *(0, "t", f"one row each {drive.period:.4g} s, {1 / drive.period:.3g} Hz"),
            f"record at {limits.slowest_rate:g} Hz or faster, or state the unit of time",
        )


def check_bunched(drive: Drive, limits: Limits) -> None:
    """Cuts rows that were stamped on delivery, in a bunch of which only the last is right."""
    close = np.diff(drive.t, append=np.inf) < limits.bunched_periods * drive.period
    drive.cut(close, "t", "stamped right before the next row, late on delivery")


def check_gaps(drive: Drive, limits: Limits) -> None:
    """Finds where rows are missing; stretches end there.

    A step is a gap above max(gap_periods, 1 + gap_jitter * jitter) nominal periods, at most
    gap_most, where jitter is the robust relative spread of the steps.
    """
    step = np.diff(drive.t) / drive.period
    jitter = 1.4826 * np.median(np.abs(step - 1))  # standard deviation of a normal spread
    most = min(max(limits.gap_periods, 1 + limits.gap_jitter * jitter), limits.gap_most)
    drive.longest_step = most * drive.period
    late = np.flatnonzero(step > most)
    if len(late):
        longest = step[late].max() * drive.period
        drive.note(late + 1, "t", f"rows missing before it, up to {longest:.3g} s: cut")
