"""Checks of the commands: range, sign of the steering, where the throttle rests."""

import numpy as np
from numpy import ndarray
from scipy.ndimage import minimum_filter1d

from buggy_rl.recordings.checks.heading import chord_speed, chords
from buggy_rl.recordings.columns import ColumnMap, Throttle
from buggy_rl.recordings.raw_recording import RawRecording
from buggy_rl.recordings.recording import Limits

LONGEST_LAG = 0.5  # [s] from a steering command to the yaw rate; four times DART's 0.13 s
LAG_STEP = 0.02  # [s] between the lags that are tried
SIGNIFICANT = 0.7  # correlation above which the sign of the steering is certain; chosen
LEAST_STEERING = 0.05  # standard deviation of the commands below which no sign is estimated
FASTEST_TURN = 20.0  # [rad/s] yaw rate above which a row is next to a cut; a small car makes 7
SILENT = 3.0  # [s] without a new command; a lap at a steady speed has corners more often
OFTEN = 0.2  # [s] between commands, median, below which a stop of theirs is told of; chosen
ROUNDING = 1e-9  # of the command range, from the conversion of units


def clip_commands(raw: RawRecording, columns: ColumnMap, factor: ndarray | None) -> None:
    """Converts raw commands to [-1, 1].

    drive = factor (command - rest) / (full - rest),  throttle = 2 drive - 1, or with reverse
    throttle = drive, below rest over (rest - lowest);
    steering linear from right -> -1 over centre -> 0 to left -> +1.

    Args:
        raw: Its `action` [T, 2] holds the file's commands and is replaced.
        columns: The ranges.
        factor: [T] multiplies the drive; None for 1.

    Raises:
        RecordingError: A command is outside its stated range.
    """
    ends, excess = columns.throttle, columns.limits.command_excess
    span = ends.full - ends.rest
    drive = (raw.action[:, 0] - ends.rest) / span
    lowest = 0.0 if ends.lowest is None else (ends.lowest - ends.rest) / span
    if raw.reverse:
        drive, lowest, excess = np.where(drive < 0, -drive / lowest, drive), -1.0, 2 * excess
    _refuse_outside(raw, "throttle", drive, lowest, excess / 2)  # drive spans half of [-1, 1]
    if factor is not None:
        drive = drive * factor
    _note_clipped(raw, "throttle", drive, -1.0 if raw.reverse else 0.0)
    if raw.reverse:
        raw.action = np.stack([np.clip(drive, -1, 1), _steering(raw, columns)], -1)
        return
    if ends == Throttle() and drive.min() >= 0.5:
        text = "never below 0, half drive: if 0 is no drive, state throttle: {rest: 0}"
        raw.note_column("throttle", text)
    raw.action = np.stack([2 * np.clip(drive, 0, 1) - 1, _steering(raw, columns)], -1)


def _steering(raw: RawRecording, columns: ColumnMap) -> ndarray:
    ends = columns.steering
    off = raw.action[:, 1] - ends.middle
    if ends.deadband:
        off = np.sign(off) * np.maximum(np.abs(off) - ends.deadband, 0.0)
    left, right = (
        (end - ends.middle) * (1 - ends.deadband / abs(end - ends.middle))
        for end in (ends.left, ends.right)
    )
    to_left, to_right = off / left, off / right
    value = np.where(to_left >= 0, to_left, -to_right)
    _refuse_outside(raw, "steering", value, -1.0, columns.limits.command_excess)
    _note_clipped(raw, "steering", value, -1.0)
    return np.clip(value, -1, 1)


def _refuse_outside(
    raw: RawRecording, channel: str, value: ndarray, lowest: float, excess: float
) -> None:
    bad = (value < lowest - excess) | (value > 1 + excess)
    if bad.any():
        at = int(np.argmax(bad))
        command = raw.action[at, 0 if channel == "throttle" else 1]
        message = (
            f"{command:.6g} is outside the range of the command, as are {bad.mean():.1%} of the "
            f"rows; state the file's range under {channel} in a column map"
        )
        raise raw.error(at, channel, message)


def _note_clipped(raw: RawRecording, channel: str, value: ndarray, lowest: float) -> None:
    outside = (value < lowest - ROUNDING) | (value > 1 + ROUNDING)
    if outside.any():
        text = f"clipped, it reached {value.min():.3g} to {value.max():.3g} of its range"
        remedy = " (no reverse)" if channel == "throttle" and not raw.reverse else ""
        raw.note(np.flatnonzero(outside), channel, text + remedy)


def check_steering_sign(raw: RawRecording, limits: Limits) -> None:
    """Notes a steering command that turns the car the other way.

    It does not refuse: a slalom whose half period equals the car's lag has the same correlation.
    """
    rate = np.gradient(raw.yaw, raw.t)
    if raw.reverse:  # the same steering turns a car the other way when it drives backward
        rate = rate * np.sign(speed_along(raw))
    lags = range(0, int(LONGEST_LAG / raw.period), max(1, int(LAG_STEP / raw.period)))
    best = max((_correlation(raw, rate, lag, limits) for lag in lags), key=abs, default=0.0)
    if best < -SIGNIFICANT:
        raw.note_column(
            "steering",
            f"steering left turns the car right (correlation {best:.2f}): if so, state "
            "signs: {steering: -1} in a column map",
        )


def check_silence(raw: RawRecording, limits: Limits) -> None:
    """Notes commands that stop while the car moves: bit for bit the same, where they often change.

    It does not refuse: a steady manoeuvre has the same commands.
    """
    changes = np.flatnonzero((np.diff(raw.action, axis=0) != 0).any(-1)) + 1
    begin = np.concatenate([[0], changes])
    end = np.concatenate([changes, [len(raw.t)]]) - 1
    seconds = raw.t[end] - raw.t[begin]
    if len(changes) < 2 or np.median(np.diff(raw.t[changes])) > OFTEN:
        return
    step = np.linalg.norm(np.diff(raw.pose[:, :2], axis=0, append=np.nan), axis=-1)
    moving = step > limits.moving_speed * raw.period
    silent = [i for i in np.flatnonzero(seconds > SILENT) if moving[begin[i] : end[i]].mean() > 0.5]
    if not silent:
        return
    longest = max(silent, key=lambda i: seconds[i])
    raw.note(
        np.arange(begin[longest], end[longest] + 1),
        "throttle",
        f"the commands stop for {seconds[longest]:.2g} s while the car moves ({len(silent)} such "
        "places): if the radio or the logger was silent, cut these rows",
    )


def speed_along(raw: RawRecording) -> ndarray:
    """Speed [T] along the heading [m/s], from the pose; negative backward."""
    x, y = np.gradient(raw.pose[:, 0], raw.t), np.gradient(raw.pose[:, 1], raw.t)
    return x * np.cos(raw.yaw) + y * np.sin(raw.yaw)


def _correlation(raw: RawRecording, rate: ndarray, lag: int, limits: Limits) -> float:
    """Correlation of the steering command with the yaw rate `lag` rows later, while moving."""
    command, delayed = raw.action[: len(rate) - lag, 1], rate[lag:]
    step = np.linalg.norm(np.diff(raw.pose[:, :2], axis=0, append=np.nan), axis=-1)
    moving = (step > limits.moving_speed * raw.period)[lag:] & raw.keep[lag:]
    moving &= np.isfinite(delayed) & (np.abs(delayed) < FASTEST_TURN)
    if moving.sum() < 1 / raw.period or command[moving].std() < LEAST_STEERING:  # 1 s of motion
        return 0.0
    return float(np.corrcoef(command[moving], delayed[moving])[0, 1])


NEAR = 0.02  # of a command at its rest; a joystick that is released returns this near
SETTLED = 0.2  # [s] that a command must have been held for: longer than drives and trackers lag
STANDING = 0.05  # [m/s] below which the car stands: 10 times a tracker's noise over the chord
LEAST_TIME = 0.5  # [s] of standing or of slow coasting below which no rest is judged; chosen
SLOW = 0.4  # of the 95 % quantile of the speed: below it half drive makes a car faster
COASTS = -0.1  # [m/s^2] slowing down; ten times the noise of a tracker over the chord
MOSTLY = 0.8  # share of the rows of a kind that shows it; chosen
REVERSING = 0.05  # command below rest by more than this while the car reverses
UNDRIVEN = 0.01  # drive below which nothing is asked for; an idle output is never this large
TWO_WAY = (
    "a one-way throttle rests at -1, where 0 is half drive; below 0 this one brakes or reverses: "
    "state command: {kind: throttle_brake_reverse} in a column map"
)
RESTS = (
    "a one-way throttle rests at -1, where 0 is half drive: state throttle: {rest: 0} in a column "
    "map"
)
ADMIT = ", or, if 0 is half drive here, limits: {zero_rest_share: 1}"


def check_rest(raw: RawRecording, limits: Limits) -> None:
    """A one-way throttle does not rest at 0, half drive, nor goes below it to reverse.

    Rest is the command while the car stands, or while it slows down at low speed, where half drive
    would make it faster; a drive with more of that at -1 is a one-way throttle's.

    Raises:
        RecordingError: It does; the message names the column map that reads it.
    """
    if raw.reverse or raw.rest_declared:
        return
    rows, speed = chords(raw)[0], chord_speed(raw)
    if len(rows) < 3:
        return
    throttle, magnitude = raw.action[:, 0], np.abs(speed)
    if not (magnitude > limits.moving_speed).any():
        return
    standing, moving = magnitude < STANDING, magnitude > limits.moving_speed
    undriven = standing | (moving & (np.gradient(magnitude, raw.t[rows]) < COASTS))
    held = _held(raw, np.abs(throttle) <= NEAR)[rows] & (standing | moving)
    slow = magnitude < SLOW * np.quantile(magnitude, 0.95)
    shown, at_lowest = held & undriven & slow, undriven & slow & (throttle[rows] <= -1 + NEAR)
    seconds = shown.sum() * raw.period
    often = (held & undriven).sum() > limits.zero_rest_share * held.sum()
    if seconds >= LEAST_TIME and often and shown.sum() > at_lowest.sum():
        at = int(rows[np.argmax(shown)])
        message = (
            f"{throttle[at]:.3g} for {seconds:.1f} s while the car stands or slows down from low "
            f"speed; {TWO_WAY if throttle.min() < -NEAR else RESTS}{ADMIT}"
        )
        raise raw.error(at, "throttle", message)
    _refuse_reverse(raw, limits)


def _refuse_reverse(raw: RawRecording, limits: Limits) -> None:
    """Refuses a throttle that goes below 0, and not to -1, while the car reverses."""
    throttle = raw.action[:, 0]
    asked = raw.backward & (throttle > -1 + NEAR)
    below = asked & (throttle < -REVERSING)
    forward = raw.keep & ~raw.backward & (throttle > REVERSING)
    if below.sum() * raw.period < LEAST_TIME or not forward.any():
        return
    if below.sum() > max(MOSTLY, limits.zero_rest_share) * raw.backward.sum():
        at = int(np.argmax(below))
        message = f"{throttle[at]:.3g} while the car reverses; {TWO_WAY}{ADMIT}"
        raise raw.error(at, "throttle", message)


def check_driven(raw: RawRecording, limits: Limits) -> None:
    """Some drive is asked for where the car starts to move.

    Raises:
        RecordingError: None is, in any row, and the car leaves a standstill and gets faster.
    """
    drive = raw.action[:, 0] if raw.reverse else (raw.action[:, 0] + 1) / 2
    if np.abs(drive).max() > UNDRIVEN:
        return
    rows, speed = chords(raw)[0], np.abs(chord_speed(raw))
    if not len(rows):
        return
    stood = np.minimum.accumulate(speed)
    gained = speed - stood
    at = int(np.argmax(gained))
    if gained[at] > limits.undriven_gain and stood[at] < STANDING:
        message = (
            f"no drive in any row ({raw.action[0, 0]:.3g}), and the car gets {gained[at]:.2g} m/s "
            "faster from a standstill: it was pushed or carried, or its command is another column; "
            "name that column, leave such drives out, or state limits: {undriven_gain: "
            f"{np.ceil(gained[at]):g}}} for a car on a slope"
        )
        raise raw.error(int(rows[at]), "throttle", message)


def _held(raw: RawRecording, rows: ndarray) -> ndarray:
    """[T] bool: rows of a mask that were in it for the last `SETTLED` seconds."""
    count = raw.rows(SETTLED)
    past = minimum_filter1d(rows.astype(np.int8), count, origin=(count - 1) // 2, mode="constant")
    return past > 0
