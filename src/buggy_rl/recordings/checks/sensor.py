"""Checks of the tracker: frozen poses, spikes, and whether its columns agree."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy import ndarray
from scipy.ndimage import median_filter

from buggy_rl.recordings.columns import UNITS
from buggy_rl.recordings.raw_recording import RawRecording, robust_deviation, rotate_rows
from buggy_rl.recordings.recording import Limits

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


CHORD = 0.1  # [s] over which vy is derived from positions; 0.2 mm of tracker noise makes 3 mm/s
MATCH = 0.02  # share of windows that disagree under a correction that is right; chosen
LEAST_VY = 0.05  # [m/s] rms of vy above which its sign is certain; 17 times the noise over `CHORD`
LAG_STEP = 0.02  # [s] between the lags that are tried; a 25th of the agreement window
# Fourth differences of white noise have 1 + 16 + 36 + 16 + 1 times its variance.
FOURTH_DIFFERENCE_VARIANCE = 70

Candidates = dict[str, ndarray]
"""What to do -> the rate [T, C] that this makes."""


@dataclass(frozen=True)
class _Comparison:
    """A measured rate and the pose signal whose derivative it should be."""

    raw: RawRecording
    limits: Limits
    channel: str
    position: ndarray
    """[T, C] x and y [m], or unwrapped yaw [rad]."""
    rate: ndarray
    """[T, C] as measured, velocities in the body frame."""
    granted: float
    """[m] or [rad] of disagreement in a window."""

    @property
    def count(self) -> int:
        """Steps of a window."""
        return self.raw.rows(self.limits.agreement_window)

    def derivative(self, rate: ndarray) -> ndarray:
        """A rate [T, C] in the frame of the position."""
        return rotate_rows(rate, self.raw.pose[:, 2]) if rate.shape[1] == 2 else rate

    def misfit(self, rate: ndarray) -> tuple[ndarray, ndarray]:
        """First rows [n] of all windows, and whether a rate [T, C] disagrees with the position.

        |dp - int v dt| > granted + sigmas * sigma + share * max(|dp|, int |v| dt).
        """
        raw, limits, count = self.raw, self.limits, self.count
        rate = self.derivative(rate)
        kept = np.flatnonzero(raw.keep)
        noise = np.sqrt(2) * _noise(self.position[kept])
        noise += np.sqrt(count) * raw.period * _noise(rate[kept])
        granted = self.granted + limits.agreement_sigmas * noise
        rows, bad = [np.empty(0, int)], [np.empty(0, bool)]
        for segment in raw.segments():
            if len(segment) <= count:
                continue
            t, p, v = raw.t[segment], self.position[segment], rate[segment]
            moved = p[count:] - p[:-count]
            path = np.maximum(
                np.linalg.norm(moved, axis=-1),
                _integral(np.linalg.norm(v, axis=-1)[:, None], t, count)[:, 0],
            )
            off = np.linalg.norm(moved - _integral(v, t, count), axis=-1)
            rows.append(segment[:-count])
            bad.append(off > granted + limits.agreement_share * path)
        return np.concatenate(rows), np.concatenate(bad)

    def check(self, unit: str, candidates: Callable[[], Candidates], otherwise: str) -> None:
        """Cuts the windows that disagree, or refuses the recording if they are many."""
        rows, bad = self._at_best_lag()
        if len(rows) and bad.mean() > self.limits.disagreeing_share:
            shares = {text: self.misfit(rate)[1].mean() for text, rate in candidates().items()}
            best = min(shares, key=lambda text: shares[text])
            at = self._worst_row(rows, bad)
            value = ", ".join(f"{v:.3g}" for v in self.rate[at])
            message = (
                f"{value} {unit} disagrees with the derivative of the pose, as do {bad.mean():.0%} "
                f"of the windows; {best if shares[best] < MATCH else otherwise}"
            )
            raise self.raw.error(at, self.channel, message)
        cut, count = np.zeros(len(self.raw.t), bool), self.count
        for row in rows[bad]:
            cut[row : row + count + 1] = True
        self.raw.cut(cut, self.channel, "disagrees with the pose")

    def _at_best_lag(self) -> tuple[ndarray, ndarray]:
        """The misfit at the lag between the sensors with the fewest disagreeing windows.

        A velocity that a filter delays is left as it is: the diagnosis estimates its delay.
        """
        raw, rate = self.raw, self.rate
        best, best_lag = self.misfit(rate), 0
        most = int(self.limits.agreement_lag / raw.period)
        for lag in range(-most, most + 1, raw.rows(LAG_STEP)) if best[1].any() else ():
            tried = self.misfit(rate[np.clip(np.arange(len(rate)) + lag, 0, len(rate) - 1)])
            if (tried[1].sum(), abs(lag)) < (best[1].sum(), abs(best_lag)):
                best, best_lag = tried, lag
        if best_lag and best[1].mean() <= self.limits.disagreeing_share:
            way = "late" if best_lag > 0 else "early"
            text = f"agrees with the pose only if it is {abs(best_lag) * raw.period:.2g} s {way}"
            raw.note_column(self.channel, f"{text}, left as it is")
        return best

    def _worst_row(self, rows: ndarray, bad: ndarray) -> int:
        """The row with the largest disagreement, in the middle of the first run of bad windows."""
        first = int(np.argmax(bad))
        run = int(np.argmin(np.append(bad[first:], False)))
        begin = int(rows[first + run // 2])
        kept = np.flatnonzero(self.raw.keep[begin : begin + self.count + 1]) + begin
        half = max(1, len(kept) // 10)  # the chord spans a fifth of the window
        before, middle, after = kept[: -2 * half], kept[half:-half], kept[2 * half :]
        time = (self.raw.t[after] - self.raw.t[before])[:, None]
        chord = (self.position[after] - self.position[before]) / time
        off = np.linalg.norm(chord - self.derivative(self.rate)[middle], axis=-1)
        return int(middle[np.argmax(off)])


def check_linear(raw: RawRecording, limits: Limits) -> None:
    """The change of position is the integral of the velocity over 0.5 s.

    Raises:
        RecordingError: It is not in many windows; the message names the correction that matches.
    """
    v = raw.linear
    if v is None:
        return

    def candidates() -> Candidates:
        body = rotate_rows(np.gradient(raw.pose[:, :2], raw.t, axis=0), -raw.pose[:, 2])
        good = raw.keep & np.isfinite(body).all(-1)
        scale = float((body * v)[good].sum() / max((v[good] ** 2).sum(), 1e-12))
        return {
            "it matches as world-frame velocity: set velocity_frame: world": rotate_rows(
                v, -raw.pose[:, 2]
            ),
            "it matches with vx of the other sign: set signs: {vx: -1}": v * [-1, 1],
            "it matches with both signs changed: set signs: {vx: -1, vy: -1}": -v,
            "it matches with vx and vy exchanged: correct names": v[:, ::-1],
            f"it matches times {scale:.3g}: set units of vx and vy, or of x, y and t": v * scale,
        }

    compared = _Comparison(raw, limits, "vx", raw.pose[:, :2], v, limits.agreement_distance)
    compared.check("m/s (vx, vy)", candidates, "no simple correction: set derive_velocity: true")
    _check_vy_sign(raw, v[:, 1])


def check_yaw_rate(raw: RawRecording, limits: Limits) -> None:
    """The change of yaw is the integral of the yaw rate over 0.5 s.

    Raises:
        RecordingError: It is not in many windows; the message names the correction that matches.
    """
    if raw.yaw_rate is None:
        return
    rate = raw.yaw_rate[:, None]
    candidates: Candidates = {
        "it matches as degrees per second: set units: {yaw_rate: deg/s}": np.radians(rate),
        "it matches with the other sign: set signs: {yaw_rate: -1}": -rate,
    }
    compared = _Comparison(raw, limits, "yaw_rate", raw.yaw[:, None], rate, limits.agreement_angle)
    compared.check("rad/s", lambda: candidates, "no simple correction: ignore the column")


def _check_vy_sign(raw: RawRecording, vy: ndarray) -> None:
    """Refuses vy [T] of the wrong sign, which is too small to show in the distance travelled."""
    count = raw.rows(CHORD)
    given, derived, rows = [np.empty(0)], [np.empty(0)], [np.empty(0, int)]
    for segment in raw.segments():
        if len(segment) <= count:
            continue
        begin, end = segment[:-count], segment[count:]
        yaw = np.unwrap(raw.pose[segment, 2])
        chord = raw.pose[end, :2] - raw.pose[begin, :2]
        middle = (yaw[:-count] + yaw[count:]) / 2
        derived.append(rotate_rows(chord, -middle)[:, 1] / (raw.t[end] - raw.t[begin]))
        given.append((vy[begin] + vy[end]) / 2)
        rows.append(begin)
    measured, reference = np.concatenate(given), np.concatenate(derived)
    if not len(reference):
        return
    rms, flipped = _rms(reference), _rms(measured + reference)
    if rms > LEAST_VY and flipped < 0.5 * rms and flipped < 0.5 * _rms(measured - reference):
        at = int(np.concatenate(rows)[np.argmax(np.abs(reference))])
        message = f"{vy[at]:.3g} m/s has the opposite sign of the motion; set signs: {{vy: -1}}"
        raise raw.error(at, "vy", message)


def _rms(values: ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _noise(values: ndarray) -> float:
    """Standard deviation of the white noise on a smooth signal [n, C], from fourth differences.

    A smooth signal has small fourth differences; the median is insensitive to leaps.
    """
    if len(values) < 5:
        return 0.0
    fourth = np.linalg.norm(np.diff(values, 4, axis=0), axis=-1)
    return float(robust_deviation(fourth) / np.sqrt(FOURTH_DIFFERENCE_VARIANCE))


def _integral(v: ndarray, t: ndarray, count: int) -> ndarray:
    """Trapezoidal integral of v [n, C] over each window of `count` steps, [n - count, C]."""
    parts = 0.5 * (v[1:] + v[:-1]) * np.diff(t)[:, None]
    total = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(parts, 0)])
    return total[count:] - total[:-count]
