"""Which columns are position and heading, with the units and signs that agree with each other."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy import ndarray
from scipy.signal import savgol_filter

from buggy_rl.inspection.clock import RowStamps
from buggy_rl.recordings.columns import DEGREE, UNITS
from buggy_rl.recordings.raw_recording import wrap_angles

SMOOTHING = 0.3  # [s] of the derivative; a particle filter's 2 cm of noise needs it
MOVING = 0.3  # [m/s] speed above which a course is taken
REVERSES = 0.02  # share of the moving time; a spin or a leap of the tracker takes less
FASTEST = 60.0  # [m/s] that a position may move at, in its unit; above it is none
LEAST_MOVING = 0.02  # share of the time; below it the car stands
PLACE = 0.5  # [deg] 50 km: a drive's width in latitude and longitude is less
MOST_TURNS = 100.0  # [-] of a heading that is counted on; beyond it is none
LEAST_AGREEMENT = 0.7  # mean cosine of course and heading for a pair to be proposed
# Mean of its magnitude where a car also reverses; that of any other heading is 2 / pi = 0.64.
BOTH_WAYS = 0.85
HEADING = re.compile(r"yaw|head|theta|psi|quat|orient|(^|[^a-z])q_?[wxyz]", re.IGNORECASE)
DEAD_RECKONING = re.compile(r"odom", re.IGNORECASE)
TRACKERS = re.compile(r"vicon|mocap|optitrack|track|pf|gps|amcl|pose|slam", re.IGNORECASE)
NORTH = {"easting": "northing", "east": "north", "e": "n"}
GRID = re.compile(r"easting|east|(?<=_)e(?=$|_)", re.IGNORECASE)
NO_POSITION = re.compile(
    r"acc|imu|vel|gyro|force|mag|(^|[^a-z])[avw]_?[xy]($|[^a-z])|(^|\.)q.?[xy]$", re.IGNORECASE
)


@dataclass(frozen=True)
class Pose:
    """Position and heading of a table."""

    table: str
    names: dict[str, str]
    """Channel -> column: x, y and yaw, or x, y and qw to qz."""
    degrees: bool
    """Yaw is in degrees."""
    sign: float
    """Sign of yaw."""
    xy: ndarray
    """[T, 2] m."""
    yaw: ndarray
    """[T] rad, unwrapped."""
    clock: RowStamps
    cosine: float
    """Mean of course minus yaw while moving; of its magnitude where the car reverses."""
    unit: str = "m"
    """Unit of the position in the file."""
    backward: float = 0.0
    """Share of the moving time in which the course is against the heading."""

    @property
    def speed(self) -> ndarray:
        """[T] along the heading, smoothed [m/s]."""
        rate = _derivative(self.xy, self.clock)
        return rate[:, 0] * np.cos(self.yaw) + rate[:, 1] * np.sin(self.yaw)

    @property
    def yaw_rate(self) -> ndarray:
        """[T] smoothed [rad/s]."""
        return _derivative(self.yaw[:, None], self.clock)[:, 0]

    @property
    def evidence(self) -> str:
        """Why these columns."""
        how = "in degrees" if self.degrees else "in radians"
        sign = ", with the other sign" if self.sign < 0 else ""
        unit = "" if self.unit == "m" else f"; in m it would move at over {FASTEST:g} m/s"
        back = f", backward in {self.backward:.0%} of the time" if self.reverses else ""
        return (
            f"the direction of travel follows this heading {how}{sign}: mean cosine "
            f"{self.cosine:.3f} while moving{back}{unit}"
        )

    @property
    def reverses(self) -> bool:
        """Whether the car drives backward for more than a moment."""
        return self.backward > REVERSES


def find_poses(
    table: str,
    columns: Mapping[str, ndarray],
    clock: RowStamps,
    constant: Mapping[str, ndarray] | None = None,
) -> list[Pose]:
    """Plausible poses of a table, the best one first.

    Args:
        table: Its name.
        columns: Those that change, [T] each.
        clock: Of the table.
        constant: Columns that may be parts of a quaternion though they do not change.
    """
    found = []
    for x, y in _pairs(columns):
        xy = np.stack([columns[x], columns[y]], -1)
        unit = _length(xy, clock)
        xy = UNITS["length"][unit] * xy
        speed = np.linalg.norm(_derivative(xy, clock), axis=-1)
        moving = speed > MOVING
        too_fast = not np.isfinite(xy).all() or np.quantile(speed, 0.9) > FASTEST
        if too_fast or moving.mean() < LEAST_MOVING:
            continue
        rate = _derivative(xy, clock)
        course = np.arctan2(rate[:, 1], rate[:, 0])
        for names, yaw, degrees, sign in _headings({**(constant or {}), **columns}, (x, y)):
            along = np.cos(course - yaw)[moving]
            cosine = _agreement(along)
            if cosine is not None:
                unwrapped = np.unwrap(wrap_angles(yaw))
                all_names = {"x": x, "y": y, **names}
                pose = Pose(table, all_names, degrees, sign, xy, unwrapped, clock, cosine, unit)
                found.append(replace(pose, backward=float((along < -LEAST_AGREEMENT).mean())))
    return sorted(found, key=lambda pose: -_rank(pose))


def why_no_pose(columns: Mapping[str, ndarray], clock: RowStamps) -> str:
    """Why no columns of a table are a position and a heading."""
    pairs = list(_pairs(columns))
    if not pairs:
        return "no two columns are a position: none are named as x and y, or as east and north"
    reasons = []
    for x, y in pairs:
        xy = np.stack([columns[x], columns[y]], -1)
        rate = UNITS["length"][_length(xy, clock)] * _derivative(xy, clock)
        speed = np.linalg.norm(rate, axis=-1)
        fast, moving = float(np.quantile(speed, 0.9)), speed > MOVING
        if _geographic(xy):
            text = "look like longitude and latitude in degrees: project them to metres (UTM)"
            reasons.append((3, f"{x} and {y} {text}"))
        elif fast > FASTEST:
            reasons.append((0, f"{x} and {y} would move at {fast:.3g} m/s"))
        elif moving.mean() < LEAST_MOVING:
            reasons.append((1, f"{x} and {y} hardly move, 90 % of the time below {fast:.2g} m/s"))
        else:
            reasons.append((2, _why_no_heading(columns, (x, y), rate, moving)))
    return max(reasons)[1]


def _geographic(xy: ndarray) -> bool:
    """Whether positions [T, 2] are degrees of longitude and latitude, in either order."""
    middle, width = np.abs(np.nanmedian(xy, axis=0)), np.ptp(xy, axis=0)
    within = middle.max() <= 180 and middle.min() <= 90
    return bool(within and middle.min() > 1 and 0 < width.max() < PLACE)


def _why_no_heading(
    columns: Mapping[str, ndarray], used: tuple[str, str], rate: ndarray, moving: ndarray
) -> str:
    where = f"{used[0]} and {used[1]} move as a car does, but no column is a heading"
    course = np.arctan2(rate[:, 1], rate[:, 0])[moving]
    found = [
        (", ".join(names.values()), np.exp(1j * (course - yaw[moving])).mean())
        for names, yaw, _, _ in _headings(columns, used)
    ]
    found = [h for h in found if HEADING.search(h[0])] or found
    if not found:
        return f"{where} in radians or degrees, or a quaternion"
    name, mean = max(found, key=lambda h: abs(h[1]))
    if abs(mean) > BOTH_WAYS:
        turned = f"{np.degrees(np.angle(mean)):.0f} degrees"
        return f"{where}: the direction of travel is {turned} from {name} all the time"
    return (
        f"{where} that the direction of travel follows: {name} comes nearest, mean cosine "
        f"{mean.real:.2f} ({LEAST_AGREEMENT:g} is needed)"
    )


def _agreement(along: ndarray) -> float | None:
    """How well a course follows a heading, by the cosines [M] of their difference; None: not.

    A car that reverses drives along its heading both ways, and forward for the longer time.
    """
    forward, either = float(along.mean()), float(np.abs(along).mean())
    if forward > LEAST_AGREEMENT:
        return forward
    return either if either > BOTH_WAYS and forward > 0 else None


def _length(xy: ndarray, clock: RowStamps) -> str:
    """Unit of a position [T, 2]: m, or mm where nothing moves as fast as it would."""
    speed = np.linalg.norm(_derivative(xy, clock), axis=-1)
    return "m" if np.quantile(speed, 0.9) <= FASTEST else "mm"


def best_pose(poses: Sequence[Pose]) -> Pose:
    """The most plausible pose of a drive, over all of its tables."""
    return max(poses, key=_rank)


def _rank(pose: Pose) -> float:
    """Agreement; a tracker's name counts for it, dead reckoning against it: that drifts."""
    words = f"{pose.table} {pose.names['x']}"
    reckoned = bool(DEAD_RECKONING.search(words))
    return pose.cosine + 0.3 * bool(TRACKERS.search(words)) - 0.6 * reckoned


def _pairs(columns: Mapping[str, ndarray]) -> Iterator[tuple[str, str]]:
    """Columns whose names differ in one letter, x and y, or in east and north; no rates.

    Columns without names, that are numbered, are taken side by side.
    """
    for x in columns:
        if x.isdigit():  # without a line of names: side by side, whatever they hold
            if str(int(x) + 1) in columns:
                yield x, str(int(x) + 1)
            continue
        y = GRID.sub(lambda found: _north(found[0]), x)
        if y != x and y in columns and not NO_POSITION.search(x):
            yield x, y
        for at, letter in enumerate(x):
            y = x[:at] + chr(ord(letter) + 1) + x[at + 1 :]
            if letter in "xX" and y in columns and not NO_POSITION.search(x):
                yield x, y


def _north(east: str) -> str:
    """The word for north in the case of the one for east."""
    north = NORTH[east.lower()]
    return north.upper() if east.isupper() else north.capitalize() if east.istitle() else north


Heading = tuple[dict[str, str], ndarray, bool, float]
"""Channel -> column, yaw [T] rad, whether in degrees, sign."""


def _headings(columns: Mapping[str, ndarray], used: tuple[str, str]) -> Iterator[Heading]:
    yield from _quaternions(columns)
    for name, values in columns.items():
        if name in used or not np.isfinite(values).all():
            continue
        largest = np.abs(values).max()
        for degrees in (False, True):
            turns = largest / (360.0 if degrees else 2 * np.pi)
            if largest < (10.0 if degrees else 1.0) or turns > MOST_TURNS:
                continue
            for sign in (1.0, -1.0):
                yield {"yaw": name}, sign * values * (DEGREE if degrees else 1.0), degrees, sign


def _quaternions(columns: Mapping[str, ndarray]) -> Iterator[Heading]:
    """Four columns of unit length that end in w, x, y, z, or are numbered in ROS's order x to w.

    x and y may be constant.
    """
    for w in columns:
        if w.isdigit():
            names = {f"q{axis}": str(int(w) - back) for back, axis in enumerate("wzyx")}
            if not set(names.values()) <= set(columns):
                continue
        elif w.endswith(("w", "W")) and w[:-1] + ("z" if w[-1] == "w" else "Z") in columns:
            stem, zs = w[:-1], w[:-1] + ("z" if w[-1] == "w" else "Z")
            names = {"qw": w, "qx": stem + "x", "qy": stem + "y", "qz": zs}
        else:
            continue
        qw, qx, qy, qz = (columns.get(names[f"q{a}"], np.zeros_like(columns[w])) for a in "wxyz")
        norm = np.sqrt(qw**2 + qx**2 + qy**2 + qz**2)
        if not np.allclose(norm, 1.0, atol=0.02) or not np.ptp(qz) + np.ptp(qw):
            continue
        yaw = np.arctan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))
        yield names, yaw, False, 1.0
        yield names, -yaw, False, -1.0


def _derivative(values: ndarray, clock: RowStamps) -> ndarray:
    """Rate of change [T, C] by a Savitzky-Golay filter over `SMOOTHING`, rows taken as even."""
    rows = max(round(SMOOTHING / clock.period) | 1, 5)
    if len(values) <= rows:
        return np.gradient(values, clock.t, axis=0)
    return np.asarray(savgol_filter(values, rows, 2, deriv=1, delta=clock.period, axis=0))
