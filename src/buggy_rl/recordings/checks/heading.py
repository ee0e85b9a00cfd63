"""Check of yaw against the course over ground: unit, sign, mounting.

Reverse is cut out unless the command has reverse: then a car may drive along its heading both ways.
"""

from typing import NamedTuple

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.limits import Limits
from buggy_rl.recordings.raw_recording import RawRecording, wrap_angle

WINDOW = 0.2  # [s] chord whose direction is the course; 6 cm at `moving_speed`, noise 1 mm
LEAST_MOTION = 0.5  # [s] of motion below which no heading is checked; chosen
LEAST_STRAIGHT = 1.0  # [s] of straight driving below which no mounting error is noted; chosen
STRAIGHT = 0.2  # [rad/s] yaw rate below which a lever arm of 0.1 m adds 0.02 m/s at most
MATCH = 0.95  # mean cosine of course minus yaw for the right yaw: 18 degrees of sideslip
ALONG = 0.7  # cosine of course minus yaw (45 degrees) above which a car drives forward, below
# whose negative backward; no tyre lets a car drift for long beyond it
BOTH_WAYS = 0.9  # share of moving rows along the heading, either way, where yaw is right; chosen
LEAST_REVERSE = 0.1  # [s] that a noisy tracker at rest does not seem to reverse for; chosen
LEAST_FORWARD = 0.05  # share of moving rows forward: with less, yaw may be off by pi; chosen

REMEDIES = {
    "read as degrees": "it matches in degrees: set units: {{yaw: deg}} in a column map",
    "with the other sign": "it matches with the other sign: set signs: {{yaw: -1}}",
    "with x and y exchanged": "it matches with x and y exchanged: correct names",
    "rotated": "it matches rotated: set mount: {{yaw: {offset:.3f}}}",
}
"""Correction of yaw -> what to do about it."""
REVERSE = (
    "{match}; if the car reverses throughout, there is no forward driving to learn from, unless "
    "the command is declared to have reverse"
)
DECLARE = (
    "the car reverses, which a one-way command cannot: to read it, declare in the column map or "
    "the car's file command: {kind: throttle_brake_reverse}, {kind: current} or {kind: speed, "
    "reverse: true}"
)
ASKED = 0.2  # [-] drive either way that shows where the car is meant to go; chosen
AGAINST = -0.5  # mean product of the signs of drive and motion below which yaw is off by pi; chosen


class Courses(NamedTuple):
    """Rows in which the car moves, n of them."""

    rows: ndarray
    """[n] of the recording's arrays."""
    course: ndarray
    """[n] direction of travel [rad]."""
    yaw: ndarray
    """[n] as recorded [rad]."""
    rate: ndarray
    """[n] yaw rate [rad/s]."""

    @property
    def cosine(self) -> ndarray:
        """[n] of the angle between course and yaw."""
        return np.cos(self.course - self.yaw)


def check_heading(raw: RawRecording, limits: Limits) -> None:
    """Yaw follows the course: mean cos(course - yaw) is high while the car moves.

    A car that drives both ways along its heading reverses: that is cut where the command has no
    reverse. Where it has, the course is taken modulo pi, and yaw must go with the drive's sign.

    Raises:
        RecordingError: It is not; the message names the correction that matches.
    """
    found = _courses(raw, limits)
    if not raw.reverse and reverses(found):
        _cut_reverse(raw, found)
        found = _courses(raw, limits)
    rows, course, yaw, rate = found
    if len(rows) < LEAST_MOTION / raw.period:
        return
    fold = 2 if raw.reverse else 1  # of a course modulo pi
    offset = float(np.angle(np.exp(1j * fold * (yaw - course)).mean())) / fold  # circular mean
    cosines = {
        "as recorded": np.cos(course - yaw),
        "read as degrees": np.cos(course - np.radians(yaw)),
        "with the other sign": np.cos(course + yaw),
        "with x and y exchanged": np.cos(np.pi / 2 - course - yaw),
        "rotated": np.cos(course - yaw + offset),
    }
    if raw.reverse:
        cosines = {n: np.where(cosine < -ALONG, -cosine, cosine) for n, cosine in cosines.items()}
    means = {name: float(cosine.mean()) for name, cosine in cosines.items()}
    best, recorded = max(means, key=lambda name: means[name]), means["as recorded"]
    at = int(rows[np.argmin(cosines["as recorded"])])
    degrees = np.abs(yaw).max() > 2 * np.pi and means["read as degrees"] > MATCH > recorded
    if degrees:
        at, best = int(rows[np.argmax(np.abs(yaw))]), "read as degrees"
    if degrees or recorded < limits.heading_agreement:
        remedy = "check unit, sign and mounting of yaw, and which axes x and y are"
        if means[best] > MATCH and best in REMEDIES:
            remedy = REMEDIES[best].format(offset=offset)
        if best == "rotated" and recorded < -ALONG:
            remedy = REVERSE.format(match=remedy)
        message = (
            f"yaw {raw.pose[at, 2]:.4g} rad does not follow the direction of travel: mean cosine "
            f"{recorded:.2f}, expected {limits.heading_agreement:g} or more; {remedy}"
        )
        raise raw.error(at, "yaw", message)
    sideslip = wrap_angle(course - yaw)
    if raw.reverse:
        _refuse_turned(raw, found)
        sideslip = wrap_angle(fold * sideslip) / fold
    _note_mount(raw, limits, sideslip[np.abs(rate) < STRAIGHT])


def _refuse_turned(raw: RawRecording, found: Courses) -> None:
    """Refuses a yaw that is off by pi, which a course modulo pi does not show.

    Raises:
        RecordingError: The car mostly drives backward when its command is forward, and vice versa.
    """
    drive = raw.action[found.rows, 0]
    asked = np.abs(drive) > ASKED
    if asked.sum() * raw.period < LEAST_MOTION:
        return
    agreed = float((np.sign(drive) * np.sign(found.cosine))[asked].mean())
    if agreed < AGAINST:
        at = int(found.rows[asked][0])
        message = (
            f"yaw {raw.pose[at, 2]:.4g} rad is against the motion where the command is forward, "
            f"and along it where it is backward (agreement {agreed:.2f}, expected above "
            f"{AGAINST:g}): set mount: {{yaw: 3.142}}, or exchange full and lowest of throttle"
        )
        raise raw.error(at, "yaw", message)


def reverses(found: Courses) -> bool:
    """Whether the car drives along its heading, forward and backward."""
    forward, backward = found.cosine > ALONG, found.cosine < -ALONG
    if not backward.any():
        return False
    return forward.mean() > LEAST_FORWARD and (forward | backward).mean() > BOTH_WAYS


def _cut_reverse(raw: RawRecording, found: Courses) -> None:
    """Cuts the reverse drives, from standstill to standstill."""
    rows, along = chords(raw)[0], chord_speed(raw)
    backward = np.zeros(len(raw.t), bool)
    backward[found.rows[found.cosine < -ALONG]] = True
    negative = np.zeros(len(raw.t), bool)
    negative[rows[along < 0]] = True
    for run in np.split(rows, np.flatnonzero(np.diff(negative[rows].astype(int)) != 0) + 1):
        if backward[run].sum() * raw.period >= LEAST_REVERSE:
            raw.backward[run[0] : run[-1] + 1] = True
    raw.cut(raw.backward, "yaw", DECLARE)


def chords(raw: RawRecording) -> tuple[ndarray, ndarray, ndarray]:
    """Kept rows in the middle, at the begin and at the end of each chord over `WINDOW`."""
    half, kept = raw.rows(WINDOW / 2), np.flatnonzero(raw.keep)
    if len(kept) <= 2 * half:
        return kept[:0], kept[:0], kept[:0]
    return kept[half:-half], kept[: -2 * half], kept[2 * half :]


def chord_speed(raw: RawRecording) -> ndarray:
    """Speed [n] along the heading at the middle of each chord [m/s]; negative backward."""
    rows, before, after = chords(raw)
    yaw = raw.pose[rows, 2]
    chord = raw.pose[after, :2] - raw.pose[before, :2]
    return (chord[:, 0] * np.cos(yaw) + chord[:, 1] * np.sin(yaw)) / (raw.t[after] - raw.t[before])


def _courses(raw: RawRecording, limits: Limits) -> Courses:
    rows, before, after = chords(raw)
    time = raw.t[after] - raw.t[before]
    chord = raw.pose[after, :2] - raw.pose[before, :2]
    speed = np.linalg.norm(chord, axis=-1) / time
    good = (time < 2 * WINDOW) & (speed > limits.moving_speed) & (speed < limits.top_speed)
    course = np.arctan2(chord[:, 1], chord[:, 0])
    rate = wrap_angle(raw.pose[after, 2] - raw.pose[before, 2]) / time
    return Courses(rows[good], course[good], raw.pose[rows[good], 2], rate[good])


def _note_mount(raw: RawRecording, limits: Limits, sideslip: ndarray) -> None:
    """Notes a median sideslip [n] on straights that is a mounting error."""
    if len(sideslip) * raw.period < LEAST_STRAIGHT:
        return
    off = float(np.median(sideslip))
    if abs(off) > limits.mount_yaw:
        raw.note_column(
            "yaw",
            f"driving straight the car moves {off:+.3f} rad off its heading: if the tracker is "
            f"mounted so, state mount: {{yaw: {-off:.3f}}}",
        )
