"""What sensors beside the tracker say without a simulator: lateness of the pose, slip of wheels.

Lateness tau: the pose's yaw rate r_p follows the gyroscope's r_g, both through the same
Savitzky-Golay filter,

    r_p(t) = a + k r_g(t - tau),

with the least squared residual over all recordings. Slip: the wheels' speed w over the car's is

    w / vx = k (1 + c ax),

with k of the wheel's radius and c ax the slip ratio of a tyre that drives or brakes. A late pose
looks like slip that falls with the speed, tau ax / vx: where no gyroscope tells tau it is fitted
too. 95 % intervals are of a jackknife over ten blocks of rows.

Source: slip ratio, Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 1.2.1; delay by the
least squared residual, Carter 1987, Coherence and time delay estimation, Proc. IEEE 75(2).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy import ndarray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import savgol_filter

from buggy_rl.core import keys
from buggy_rl.diagnosis.search.posterior import NORMAL
from buggy_rl.recordings import Recording
from buggy_rl.recordings.columns import ColumnMap
from buggy_rl.recordings.resampling import ORDER

EARLIEST, LATEST = -0.3, 0.3  # [s] lateness that is looked for
STEPS = 4  # lags tried in a control period, between which a parabola is laid
WINDOW = ColumnMap().smoothing_window  # [s] of the Savitzky-Golay filter
BLOCKS = 10  # of the jackknife
FOLLOWS = 0.8  # [-] least share of the pose's yaw rate that a gyroscope explains; chosen
ROLLING = 0.3  # [-] share of the 90 % quantile of the speed from which slip is taken; chosen
LATE = "the pose comes after the gyroscope by"
EARLY = "the gyroscope comes after the pose (as may commands that the same computer stamps) by"
METRES = 0.5, 2.0  # [-] scale within which a wheel speed is in m/s; chosen
PULLS = 0.3  # [m/s^2] 90 % quantile of the acceleration from which slip shows; chosen


@dataclass(frozen=True)
class SensorFinding:
    """A number that recordings tell without a simulator."""

    name: str
    words: str
    unit: str
    value: float
    low: float
    high: float
    """Bounds of the 95 % interval."""

    def line(self) -> str:
        """Says it in words; a pose that comes before the gyroscope has the two exchanged."""
        words, ends = self.words, (self.value, self.low, self.high)
        if self.name == "pose_lateness" and self.value < 0:
            words, ends = EARLY, (-self.value, -self.high, -self.low)
        factor, unit, digits = {"s": (1000, "ms", 0), "-": (100, "%", 1)}.get(
            self.unit, (1, self.unit, 4)
        )
        value, low, high = (f"{factor * end:.{digits}f}" for end in ends)
        return f"{words} {value} {unit} ({low} to {high})"

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return asdict(self)


def other_sensors(recordings: Sequence[Recording]) -> list[SensorFinding]:
    """What gyroscope and wheel speeds of recordings say; nothing of those that have none."""
    found = _of_gyroscope(recordings)
    late = next((f.value for f in found if f.name == "pose_lateness"), None)
    return found + _of_wheels(recordings, late)


def _of_gyroscope(recordings: Sequence[Recording]) -> list[SensorFinding]:
    pieces = list(_rates(recordings))
    if not pieces:
        return []
    dt = recordings[0].dt
    lags = np.arange(round(EARLIEST * STEPS / dt), round(LATEST * STEPS / dt) + 1) * dt / STEPS
    inside = [
        np.arange(round(LATEST / dt), len(pose_rate) + round(EARLIEST / dt))
        for pose_rate, _ in pieces
    ]
    each = max(1, sum(map(len, inside)) // BLOCKS)
    sums, count = np.zeros((BLOCKS, len(lags), 6)), 0
    for (pose_rate, gyro_rate), wanted in zip(pieces, inside, strict=True):
        for rows in np.array_split(wanted, max(1, len(wanted) // each)):
            block = min(count // each, BLOCKS - 1)
            sums[block] += _moments(pose_rate[rows], gyro_rate, rows[:, None] - lags / dt)
            count += len(rows)
    late, scale, bias = _jackknife(sums, lambda total: _lateness(total, lags))
    if not np.isfinite([late, scale, bias]).all():
        return []
    return [
        SensorFinding("pose_lateness", LATE, "s", *late),
        SensorFinding("gyro_scale", "the gyroscope shows, of the pose's yaw rate,", "-", *scale),
        SensorFinding("gyro_bias", "the gyroscope at rest shows", "rad/s", *bias),
    ]


def _moments(pose_rate: ndarray, gyro_rate: ndarray, at: ndarray) -> ndarray:
    """Sums [lags, 6] of the pose's yaw rate p [n] and the gyroscope's g at rows [n, lags]."""
    p, g = pose_rate[:, None], np.interp(at, np.arange(len(gyro_rate)), gyro_rate)
    one = np.ones_like(g)
    return np.stack([part.sum(0) for part in (one, p * one, g, p * p * one, g * g, p * g)], -1)


def _lateness(total: ndarray, lags: ndarray) -> ndarray:
    """Lateness [s], scale and bias [rad/s] of the gyroscope from sums [lags, 6]; or NaN."""
    n, p, g, pp, gg, pg = total.T
    cpp, cgg, cpg = pp - p * p / n, gg - g * g / n, pg - p * g / n
    left = cpp - cpg**2 / np.maximum(cgg, 1e-12)
    best = int(np.argmin(left))
    if not 0 < best < len(lags) - 1 or left[best] > (1 - FOLLOWS) * cpp[best] or cpg[best] <= 0:
        return np.full(3, np.nan)
    before, at, after = left[best - 1 : best + 2]
    shift = 0.5 * (before - after) / max(before - 2 * at + after, 1e-12)
    k = cpg[best] / cgg[best]
    a = (p[best] - k * g[best]) / n[best]
    return np.array([lags[best] + shift * (lags[1] - lags[0]), 1 / k, -a / k])


def _of_wheels(recordings: Sequence[Recording], late: float | None) -> list[SensorFinding]:
    rows = [np.column_stack(r) for r in _slips(recordings, late or 0.0)]
    data = np.concatenate(rows) if rows else np.zeros((0, 3))
    if len(data) < 10 * BLOCKS:
        return []
    speed, pull, ratio = data[data[:, 0] > ROLLING * np.quantile(data[:, 0], 0.9)].T
    hard = float(np.quantile(pull, 0.9))
    if hard < PULLS or len(speed) < 10 * BLOCKS:
        return []
    terms = [np.ones_like(pull), pull, *([] if late is not None else [pull / speed])]
    x = np.stack(terms, -1)
    normal = np.concatenate([x[:, :, None] * x[:, None, :], (x * ratio[:, None])[:, :, None]], -1)
    sums = np.stack([block.sum(0) for block in np.array_split(normal, BLOCKS)])  # (B, P, P + 1)

    def fitted(total: ndarray) -> ndarray:
        k, slope, *_ = np.linalg.lstsq(total[:, :-1], total[:, -1], rcond=None)[0]
        return np.array([k, slope / k * hard])

    scale, slip = _jackknife(sums, fitted)
    words = f"at {hard:.1f} m/s^2 the measured wheels turn faster than the car moves by"
    found = [SensorFinding("wheel_slip", words, "-", *slip)]
    if not METRES[0] < scale[0] < METRES[1]:  # in another unit, in which slip is the same
        return found
    coasting = "coasting, the wheel speed is of the car's"
    return [SensorFinding("wheel_scale", coasting, "-", *scale), *found]


def _jackknife(
    sums: ndarray, estimate: Callable[[ndarray], ndarray]
) -> list[tuple[float, float, float]]:
    """Estimates from sums [B, ...] over blocks, each with the ends of its 95 % interval."""
    total = sums.sum(0)
    without = np.stack([estimate(total - block) for block in sums])
    spread = NORMAL * without.std(0) * np.sqrt(len(sums) - 1)
    ends = zip(estimate(total).tolist(), spread.tolist(), strict=True)
    return [(value, value - s, value + s) for value, s in ends]


def _rates(recordings: Sequence[Recording]) -> Iterator[tuple[ndarray, ndarray]]:
    """Filtered yaw rates [n] of pose and gyroscope, of pieces long enough for all lags."""
    for recording in recordings:
        dt = recording.dt
        for pose, gyro in _pieces(recording, keys.GYRO, LATEST - EARLIEST + 2 * WINDOW):
            turned = cumulative_trapezoid(gyro, dx=dt, initial=0.0)
            yield _slope(pose[:, 2], dt), _slope(turned, dt)


def _slips(
    recordings: Sequence[Recording], late: float
) -> Iterator[tuple[ndarray, ndarray, ndarray]]:
    """Speed, acceleration and wheel speed over speed [n] of rows that move forward."""
    for recording in recordings:
        dt = recording.dt
        for motion, wheel in _pieces(recording, keys.WHEEL_SPEED, 2 * WINDOW):
            vx, index = motion[:, 3], np.arange(len(wheel))
            then = np.interp(index - late / dt, index, wheel)
            ahead = vx > 0
            yield vx[ahead], _slope(vx, dt)[ahead], then[ahead] / vx[ahead]


def _pieces(recording: Recording, sensor: str, seconds: float) -> Iterator[tuple[ndarray, ndarray]]:
    """Pose and velocity [n, 6] and a sensor [n], of runs without a gap or a missing value."""
    if sensor not in recording.data.keys():  # noqa: SIM118  TensorDict has no `in`
        return
    data = recording.data
    values = data[sensor][:, 0].double().cpu().numpy()
    motion = [data[key].double().cpu().numpy() for key in (keys.POSE, keys.VELOCITY)]
    segment = data[keys.SEGMENT].cpu().numpy()
    known = np.isfinite(values)
    edges = np.flatnonzero((np.diff(segment) != 0) | (np.diff(known) != 0)) + 1
    for run in np.split(np.arange(len(values)), edges):
        if known[run[0]] and len(run) * recording.dt > seconds:
            yield np.concatenate([part[run] for part in motion], -1), values[run]


def _slope(values: ndarray, dt: float) -> ndarray:
    """Time derivative [n], by Savitzky-Golay."""
    window = max(round(WINDOW / dt) | 1, ORDER + 2)
    return np.asarray(savgol_filter(values, window, ORDER, deriv=1, delta=dt))
