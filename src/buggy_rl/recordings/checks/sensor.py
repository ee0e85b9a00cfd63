"""Checks of the tracker: frozen and repeated poses, impossible speeds, spikes."""

import numpy as np
from numpy import ndarray
from scipy.ndimage import median_filter

from buggy_rl.recordings.columns import UNITS
from buggy_rl.recordings.limits import Limits
from buggy_rl.recordings.raw_recording import RawRecording, robust_deviation

SPEED_WINDOW = 0.1  # [s] over which a speed is taken from positions; 0.7 mm noise makes 10 mm/s
SCALE = 0.35  # relative difference of a measured speed that still names the unit of the position
FAST_QUANTILE = 0.9  # of the speeds, compared with `top_speed`; a tenth may be leaps


def check_frozen(raw: RawRecording, limits: Limits) -> None:
    """Cuts rows that repeat the pose bit for bit although the car moves.

    A tracker slower than the rows repeats throughout; then every repeated row is cut.

    Raises:
        RecordingError: The pose never changes.
    """
    same = _repeats(raw, limits)
    if same[1:].all():
        raise raw.error(0, "x", "the pose is the same in all rows; check the tracker, record again")
    frozen = np.zeros_like(same)
    short = np.zeros_like(same)
    for begin, end in _runs(same):
        if _moves(raw, begin, end, limits):
            frozen[begin:end] = True
            short[begin:end] = raw.t[end - 1] - raw.t[begin - 1] < limits.glitch_duration
    if short.mean() > limits.repeat_share:
        raw.repeated = same & ~(frozen & ~short)
        share = raw.repeated.mean()
        raw.cut(raw.repeated, "x", f"the pose is slower than the rows, {share:.0%} repeat it")
    raw.cut(frozen, "x", "frozen, the pose repeats although the car moves")


def _repeats(raw: RawRecording, limits: Limits) -> ndarray:
    """Rows [T] that repeat the pose of the row before.

    Where positions come in steps that would be leaps, those that repeat the position alone: a slow
    tracker beside a fast heading.
    """
    step, same = np.diff(raw.pose, axis=0), np.zeros(len(raw.t), bool)
    held = (step[:, :2] == 0).all(-1)
    heights = np.linalg.norm(step[~held, :2], axis=-1)
    stairs = held.mean() > limits.repeat_share and len(heights) > 0
    same[1:] = held if stairs and np.median(heights) > limits.leap else (step == 0).all(-1)
    return same


def _runs(mask: ndarray) -> list[tuple[int, int]]:
    """Begin and end (exclusive) of the runs of True in a mask [T]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _moves(raw: RawRecording, begin: int, end: int, limits: Limits) -> bool:
    """Whether the car moves in rows begin to end, by its velocity or by the rows before."""
    if raw.linear is not None:
        speed = np.linalg.norm(raw.linear[begin:end], axis=-1)
        return bool(np.median(speed) > limits.moving_speed)
    return speed_beside(raw, begin - 1, -1) > limits.moving_speed


def speed_beside(raw: RawRecording, row: int, side: int) -> float:
    """Mean speed [m/s] over `SPEED_WINDOW` before (-1) or after (+1) a row."""
    other = int(np.clip(row + side * raw.rows(SPEED_WINDOW), 0, len(raw.t) - 1))
    if other == row:
        return 0.0
    distance = np.linalg.norm(raw.pose[row, :2] - raw.pose[other, :2])
    return float(distance / abs(raw.t[row] - raw.t[other]))


def check_speed(raw: RawRecording, limits: Limits) -> None:
    """The speed is that of a small car; a car that never moves is noted.

    Raises:
        RecordingError: A tenth of the rows is faster than `top_speed`.
    """
    kept = np.flatnonzero(raw.keep)
    if len(kept) < 3:
        return
    count = min(raw.rows(SPEED_WINDOW), len(kept) - 1)
    chord = np.linalg.norm(raw.pose[kept[count:], :2] - raw.pose[kept[:-count], :2], axis=-1)
    speed = chord / (raw.t[kept[count:]] - raw.t[kept[:-count]])
    fast = np.quantile(speed, FAST_QUANTILE)
    if fast > limits.top_speed:
        at = int(kept[count + np.argmax(speed > limits.top_speed)])
        message = (
            f"{fast:.4g} m/s, the 90 % quantile of the speed, exceeds top_speed "
            f"{limits.top_speed:g} m/s; check the unit of x, y and t{_unit(raw, fast, limits)}, or "
            "raise top_speed"
        )
        raise raw.error(at, "x", message)
    if speed.max() < limits.moving_speed:
        raw.note_column("x", f"the car never moves faster than {speed.max():.2g} m/s")


def _unit(raw: RawRecording, fast: float, limits: Limits) -> str:
    """The units of length in which a speed [in the file's unit /s] is that of a small car."""
    factors = {unit: factor for unit, factor in UNITS["length"].items() if factor != 1}
    slow = {u: f * fast for u, f in factors.items() if limits.moving_speed < f * fast}
    slow = {unit: speed for unit, speed in slow.items() if speed < limits.top_speed}
    if raw.linear is not None:
        measured = np.quantile(np.linalg.norm(raw.linear[raw.keep], axis=-1), FAST_QUANTILE)
        alike = {u: v for u, v in slow.items() if abs(v - measured) < SCALE * measured}
        slow = alike or slow
    told = (f"units: {{x: {unit}, y: {unit}}} makes it {v:.2g} m/s" for unit, v in slow.items())
    return "".join(f"; {text}" for text in told)


def check_spikes(raw: RawRecording, limits: Limits) -> None:
    """Cuts rows in which a measured velocity deviates from the median of its neighbours."""
    half = raw.rows(limits.leap_window, 2)
    reach = limits.leap_acceleration * limits.leap_window
    channels = [("yaw_rate", raw.yaw_rate, limits.leap_yaw_rate)]
    if raw.linear is not None:
        channels += [("vx", raw.linear[:, 0], limits.leap_speed + reach)]
        channels += [("vy", raw.linear[:, 1], limits.leap_speed + reach)]
    for channel, values, granted in channels:
        kept = np.flatnonzero(raw.keep)
        if values is None or len(kept) <= 2 * half + 1:
            continue
        off = np.abs(values[kept] - median_filter(values[kept], 2 * half + 1, mode="nearest"))
        spikes = np.zeros(len(raw.t), bool)
        spikes[kept] = off > granted + limits.leap_sigmas * robust_deviation(off)
        raw.cut(spikes, channel, "spike, off the median of its neighbours")
