"""Check of yaw against the course over ground: unit, sign, mounting.

Reverse is cut out unless the command has reverse: then a car may drive along its heading both ways.
"""

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import QUATERNION
from buggy_rl.recordings.raw_recording import RawRecording, wrap_angles
from buggy_rl.recordings.readers import Table
from buggy_rl.recordings.recording import Limits, RecordingError

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
    sideslip = wrap_angles(course - yaw)
    if raw.reverse:
        _refuse_turned(raw, found)
        sideslip = wrap_angles(fold * sideslip) / fold
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
    rate = wrap_angles(raw.pose[after, 2] - raw.pose[before, 2]) / time
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


STEP = 0.05  # [m] between the positions that a course is taken of; 70 times a tracker's noise
LEAST_STEPS = 20  # of them, 1 m, below which no order is judged; chosen
FOLLOWS = 0.95  # concentration of course minus heading of the right order: 18 degrees of sideslip
FIXED = 0.05  # [rad] that a heading changes by over a drive where its order is wrong
LEVEL = 0.05  # height over the extent of the floor below which a column is a height; chosen
TURNED = 0.3  # [rad] that the course changes by where the heading must change as well
UNKNOWN = "correct the order (expected w, x, y, z) or the frame (expected z up) by names in a map"
Y_UP = "y is up here: set names: {{x: {z}, y: {x}, qx: {qz}, qy: {qx}, qz: {qy}}}"


def check_quaternions(
    table: Table,
    raw: Mapping[str, ndarray],
    labels: Mapping[str, str],
    row: ndarray,
    limits: Limits,
) -> None:
    """Quaternions have unit length, the car is upright, and its heading follows its course.

    |q| = 1,  cos(tilt) = 1 - 2 (qx^2 + qy^2). The other orders of the four columns are tried: a car
    on a floor makes two of them zero, so that a wrong order is upright while it drives straight.

    Raises:
        RecordingError: A length differs from 1, more than `tilt_share` of the rows is tilted, or
            the heading never changes while the course does; the message names the order.
    """
    if "qw" not in raw:
        return
    q = np.stack([raw[name] for name in QUATERNION], -1)  # (T, 4)
    known = np.asarray(~np.isnan(q).any(-1))
    columns = ", ".join(labels[name] for name in QUATERNION)
    norm = np.where(known, np.linalg.norm(q, axis=-1), 1.0)
    bad = np.abs(norm - 1) > limits.quaternion_norm
    if bad.any():
        at = int(np.argmax(bad))
        message = f"quaternion length {norm[at]:.4f} is not 1; delete the row or export unit length"
        raise RecordingError(table.file, message, int(row[at]), columns)
    upright = np.where(known, _upright(q), 1.0)
    tilted = upright < np.cos(limits.tilt)
    courses = _ways(raw, known)
    if tilted.mean() > limits.tilt_share:
        at = int(np.argmax(tilted))
        tilt = np.degrees(np.arccos(np.clip(upright[at], -1, 1)))
        message = (
            f"tilt of {tilt:.0f} degrees, in {tilted.mean():.0%} of the rows; "
            f"{_remedy(table, raw, q, courses, labels, limits) or UNKNOWN}"
        )
        raise RecordingError(table.file, message, int(row[at]), columns)
    turns = _turns(_heading(q[courses[0]]), FIXED)
    if not _turns(courses[1], TURNED) or (
        turns and _follows(q, courses) > limits.heading_agreement
    ):
        return
    remedy = _remedy(table, raw, q, courses, labels, limits)
    if remedy:
        does = "does not follow the course" if turns else "never changes"
        message = f"the heading of this quaternion {does} while the car turns; {remedy}"
        raise RecordingError(table.file, message, int(row[int(np.argmax(known))]), columns)


def _upright(q: ndarray) -> ndarray:
    """Cosine [T] of the tilt of quaternions [T, 4], w first."""
    return 1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2)


def _heading(q: ndarray) -> ndarray:
    """Yaw [T] rad: atan2(2 (w z + x y), 1 - 2 (y^2 + z^2))."""
    w, x, y, z = q.T
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _ways(raw: Mapping[str, ndarray], known: ndarray) -> tuple[ndarray, ndarray]:
    """Rows [n] a `STEP` or more apart, in the file's unit or a thousandth, and the course there."""
    xy = np.stack([raw["x"], raw["y"]], -1)
    rows = np.flatnonzero(known & np.isfinite(xy).all(-1))
    if not len(rows):
        return rows, np.empty(0)
    path = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(xy[rows], axis=0), axis=-1))])
    step = max(STEP, path[-1] / (len(rows) / 2))  # in mm all rows are a step apart
    picked = rows[np.unique(np.searchsorted(path, np.arange(0, path[-1], step)))]
    move = np.diff(xy[picked], axis=0)
    return picked[:-1], np.arctan2(move[:, 1], move[:, 0])


def _follows(q: ndarray, courses: tuple[ndarray, ndarray]) -> float:
    """Concentration of course minus heading, 1 where they differ by a constant."""
    rows, course = courses
    return float(np.abs(np.exp(1j * (course - _heading(q[rows]))).mean()))


def _remedy(
    table: Table,
    raw: Mapping[str, ndarray],
    q: ndarray,
    courses: tuple[ndarray, ndarray],
    labels: Mapping[str, str],
    limits: Limits,
) -> str:
    """The order that makes the car upright and its heading follow its course; empty without one."""

    def stands(tried: ndarray) -> bool:
        return (_upright(tried) > np.cos(limits.tilt)).mean() > 1 - limits.tilt_share

    height = _height(table, labels["x"])
    if height and np.ptp(raw["y"]) < LEVEL * np.ptp(table.numbers(height)):
        if stands(q[:, (0, 3, 1, 2)]):
            return Y_UP.format(z=height, **{name: labels[name] for name in (*QUATERNION, "x")})
        return ""
    for order in _orders() if len(courses[0]) >= LEAST_STEPS else ():
        tried = q[:, order]
        turns = _turns(_heading(tried[courses[0]]), FIXED)
        if stands(tried) and turns and _follows(tried, courses) > FOLLOWS:
            pairs = zip(QUATERNION, order, strict=True)
            names = ", ".join(f"{name}: {labels[QUATERNION[i]]}" for name, i in pairs)
            return f"in another order it follows the course: set names: {{{names}}}"
    return ""


def _orders() -> Sequence[tuple[int, ...]]:
    """Orders of four columns, those that exports have first: w last read as first, and reverse."""
    usual = [(3, 0, 1, 2), (1, 2, 3, 0)]
    return [*usual, *(o for o in permutations(range(4)) if o not in (*usual, (0, 1, 2, 3)))]


def _turns(angle: ndarray, least: float) -> bool:
    """Whether angles [n] differ by more than `least` [rad], the farthest tenth left out."""
    if len(angle) < LEAST_STEPS:
        return False
    off = np.abs(np.angle(np.exp(1j * (angle - np.angle(np.exp(1j * angle).mean())))))
    return float(np.quantile(off, 0.9)) > least


def _height(table: Table, x: str) -> str:
    """The third column of a position, whose name differs from that of x in its letter."""
    for at in reversed(range(len(x))):
        if x[at] in "xX":
            z = x[:at] + chr(ord(x[at]) + 2) + x[at + 1 :]
            if z in table.columns:
                return z
    return ""
