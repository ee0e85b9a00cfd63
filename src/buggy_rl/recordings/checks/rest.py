"""Checks of a one-way throttle against the motion: where it rests, and whether it drives at all."""

import numpy as np
from numpy import ndarray
from scipy.ndimage import minimum_filter1d

from buggy_rl.recordings.checks.heading import chord_speed, chords
from buggy_rl.recordings.limits import Limits
from buggy_rl.recordings.raw_recording import RawRecording

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
