"""The tracker: frozen and repeated poses, spikes, impossible speeds."""

import numpy as np
from numpy import ndarray
from scipy.ndimage import median_filter

from buggy_rl.recordings.drive import Drive
from buggy_rl.recordings.limits import Limits

BEFORE = 0.1  # [s] over which the speed ahead of a freeze or a leap is taken


def check_frozen(drive: Drive, limits: Limits) -> None:
    """Cuts rows that repeat the pose to the last bit although the car moves.

    A tracker slower than the rows repeats all the time; then every repeated row is cut.

    Raises:
        RecordingError: The pose never changes.
    """
    same = np.zeros(len(drive.t), bool)
    same[1:] = (np.diff(drive.pose, axis=0) == 0).all(-1)
    if same[1:].all():
        raise drive.refusal(
            *(0, "x", "the pose is the same from the first to the last row"),
            "the tracker is frozen or was never read: record again",
        )
    frozen = np.zeros_like(same)
    short = np.zeros_like(same)
    for begin, end in _runs(same):
        if _moves(drive, begin, end, limits):
            frozen[begin:end] = True
            short[begin:end] = drive.t[end - 1] - drive.t[begin - 1] < limits.glitch_duration
    if short.mean() > limits.repeat_share:
        drive.repeated = same & ~(frozen & ~short)
        share = drive.repeated.mean()
        drive.cut(drive.repeated, "x", f"the pose is slower than the rows, {share:.0%} repeat it")
    drive.cut(frozen, "x", "frozen, the pose repeats although the car moves")


def _runs(mask: ndarray) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of the runs of True in a mask [T]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _moves(drive: Drive, begin: int, end: int, limits: Limits) -> bool:
    """Whether the car moves in rows begin to end, by its velocity or else by what went before."""
    if drive.linear is not None:
        speed = np.linalg.norm(drive.linear[begin:end], axis=-1)
        return bool(np.median(speed) > limits.moving_speed)
    return speed_beside(drive, begin - 1, -1) > limits.moving_speed


def speed_beside(drive: Drive, row: int, side: int) -> float:
    """Mean speed [m/s] over `BEFORE` seconds ahead of (-1) or after (+1) a row."""
    count = max(1, round(BEFORE / drive.period))
    other = int(np.clip(row + side * count, 0, len(drive.t) - 1))
    if other == row:
        return 0.0
    distance = np.linalg.norm(drive.pose[row, :2] - drive.pose[other, :2])
    return float(distance / abs(drive.t[row] - drive.t[other]))


def check_speed(drive: Drive, limits: Limits) -> None:
    """The speed over ground is that of a small car.

    Raises:
        RecordingError: It is mostly not; the positions are in another unit.
    """
    kept = np.flatnonzero(drive.keep)
    if len(kept) < 3:
        return
    count = min(max(1, round(BEFORE / drive.period)), len(kept) - 1)  # noise averages out
    chord = np.linalg.norm(drive.pose[kept[count:], :2] - drive.pose[kept[:-count], :2], axis=-1)
    speed = chord / (drive.t[kept[count:]] - drive.t[kept[:-count]])
    if np.quantile(speed, 0.9) > limits.top_speed:
        at = int(kept[count + np.argmax(speed > limits.top_speed)])
        raise drive.refusal(
            *(at, "x", f"a tenth of the rows move faster than {np.quantile(speed, 0.9):.4g} m/s"),
            "state the unit of x, y and t in a column map",
        )
    if speed.max() < limits.moving_speed:
        drive.notes.append(
            f"column {drive.label('x')!r}: the car never moves faster than {speed.max():.2g} m/s"
        )


def check_spikes(drive: Drive, limits: Limits) -> None:
    """Cuts rows in which a measured velocity leaps away from its neighbours."""
    half = max(2, round(limits.leap_window / drive.period))
    reach = limits.leap_acceleration * limits.leap_window
    channels = [("yaw_rate", drive.yaw_rate, limits.leap_yaw_rate, 0.0)]
    if drive.linear is not None:
        channels += [("vx", drive.linear[:, 0], limits.leap_speed, reach)]
        channels += [("vy", drive.linear[:, 1], limits.leap_speed, reach)]
    for channel, values, floor, widen in channels:
        kept = np.flatnonzero(drive.keep)
        if values is None or len(kept) <= 2 * half + 1:
            continue
        off = np.abs(values[kept] - median_filter(values[kept], 2 * half + 1, mode="nearest"))
        spread = 1.4826 * np.median(off)
        spikes = np.zeros(len(drive.t), bool)
        spikes[kept] = off > floor + widen + limits.leap_sigmas * spread
        drive.cut(spikes, channel, "spike, off its neighbours")
