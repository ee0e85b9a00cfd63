"""Commands: their range, and the sign of the steering."""

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import ColumnMap, Throttle
from buggy_rl.recordings.drive import Drive
from buggy_rl.recordings.limits import Limits

LAG = 0.5  # [s] longest time from a steering command to the turn that is looked for
TELLING = 0.7  # correlation from which on the sign of the steering is beyond doubt


def clip_commands(drive: Drive, columns: ColumnMap, factor: ndarray | None) -> None:
    """Brings raw commands to [-1, 1].

    drive share = factor (raw - rest) / (full - rest),  throttle = 2 share - 1;
    steering linear from right -> -1 over centre -> 0 to left -> +1.

    Args:
        drive: Its `action` [T, 2] holds raw commands and is replaced.
        columns: With the ranges.
        factor: [T] multiplies the drive share; None for 1.

    Raises:
        RecordingError: A command is outside its stated range.
    """
    ends, excess = columns.throttle, columns.limits.command_excess
    span = ends.full - ends.rest
    share = (drive.action[:, 0] - ends.rest) / span
    floor = 0.0 if ends.lowest is None else (ends.lowest - ends.rest) / span
    _refuse_outside(drive, "throttle", share, floor, excess / 2)  # share runs over half of [-1, 1]
    if factor is not None:
        share = share * factor
    _note_clipped(drive, "throttle", share, 0.0)
    if ends == Throttle() and share.min() >= 0.5:
        text = "never below 0, half drive: if 0 is no drive, state throttle: {rest: 0}"
        drive.notes.append(f"column {drive.label('throttle')!r}: {text}")
    steering = _steering(drive, columns)
    drive.action = np.stack([2 * np.clip(share, 0, 1) - 1, steering], -1)


def _steering(drive: Drive, columns: ColumnMap) -> ndarray:
    ends = columns.steering
    centre = (ends.left + ends.right) / 2 if ends.centre is None else ends.centre
    off = drive.action[:, 1] - centre
    to_left, to_right = off / (ends.left - centre), off / (ends.right - centre)
    value = np.where(to_left >= 0, to_left, -to_right)
    _refuse_outside(drive, "steering", value, -1.0, columns.limits.command_excess)
    _note_clipped(drive, "steering", value, -1.0)
    return np.clip(value, -1, 1)


def _refuse_outside(
    drive: Drive, channel: str, value: ndarray, floor: float, excess: float
) -> None:
    bad = (value < floor - excess) | (value > 1 + excess)
    if bad.any():
        at = int(np.argmax(bad))
        raw = drive.action[at, 0 if channel == "throttle" else 1]
        raise drive.refusal(
            *(at, channel, f"the command is {raw:.6g}, outside its range ({bad.mean():.1%} are)"),
            f"state the file's range under {channel} in a column map",
        )


def _note_clipped(drive: Drive, channel: str, value: ndarray, floor: float) -> None:
    beyond = (value < floor - 1e-9) | (value > 1 + 1e-9)  # 1e-9: rounding of the conversion
    if beyond.any():
        lowest, highest = value.min(), value.max()
        text = f"clipped, it reached {lowest:.3g} to {highest:.3g} of its range (no reverse)"
        drive.note(np.flatnonzero(beyond), channel, text)


def check_steering_sign(drive: Drive, limits: Limits) -> None:
    """Points out a steering command that turns the car the other way.

    Only a note: a slalom whose half period is the car's lag looks the same.
    """
    rate = np.gradient(drive.yaw, drive.t)
    best = 0.0
    lags = range(0, int(LAG / drive.period), max(1, int(0.02 / drive.period)))
    for lag in lags:
        best = max((best, _correlation(drive, rate, lag, limits)), key=abs)
    if best < -TELLING:
        drive.notes.append(
            f"column {drive.label('steering')!r}: steering left turns the car right (correlation "
            f"{best:.2f}): if so, state signs: {{steering: -1}} in a column map"
        )


def _correlation(drive: Drive, rate: ndarray, lag: int, limits: Limits) -> float:
    command, turned = drive.action[: len(rate) - lag, 1], rate[lag:]
    step = np.linalg.norm(np.diff(drive.pose[:, :2], axis=0, append=np.nan), axis=-1)
    moving = (step > limits.moving_speed * drive.period)[lag:] & drive.keep[lag:]
    moving &= np.isfinite(turned) & (np.abs(turned) < 20.0)  # [rad/s] wrong only at a cut
    if moving.sum() < 1 / drive.period or command[moving].std() < 0.05:
        return 0.0
    return float(np.corrcoef(command[moving], turned[moving])[0, 1])
