"""Checks of quaternions: unit length, an upright car, and the order of the four columns."""

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.columns import QUATERNION
from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.limits import Limits
from buggy_rl.recordings.readers import Table

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
    courses = _courses(raw, known)
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


def _courses(raw: Mapping[str, ndarray], known: ndarray) -> tuple[ndarray, ndarray]:
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
