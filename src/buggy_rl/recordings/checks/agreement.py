"""Position against velocity, heading against yaw rate: two sensors that must tell one story."""

from collections.abc import Callable

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.drive import Drive, turn
from buggy_rl.recordings.limits import Limits

CHORD = 0.1  # [s] over which vy is taken from the position: 3 mm/s of noise for a 0.2 mm tracker
FITS = 0.02  # share of windows that still disagree under a correction worth naming
TELLING_VY = 0.05  # [m/s] rms of vy below which its sign cannot be told


Misfit = Callable[[ndarray], tuple[ndarray, ndarray]]
"""Of a rate [T, C]: first rows [n] of all windows, and whether it disagrees with the pose."""


def check_linear(drive: Drive, limits: Limits) -> None:
    """Distance travelled equals integrated velocity, |dp - int R(yaw) v dt| small over 0.5 s.

    Raises:
        RecordingError: It does not in more than isolated places; the message says what would fit.
    """
    if drive.linear is None:
        return

    def misfit(linear: ndarray) -> tuple[ndarray, ndarray]:
        world = turn(linear, drive.pose[:, 2])
        return _misfits(drive, drive.pose[:, :2], world, limits, limits.agreement_distance)

    rows, bad = _at_best_lag(drive, "vx", drive.linear, misfit, limits)
    if len(rows) and bad.mean() > limits.disagreeing_share:
        world = turn(drive.linear, drive.pose[:, 2])
        window = _first_window(drive, rows, bad, limits)
        at = _worst(drive.pose[:, :2], world, drive.t, window)
        vx, vy = drive.linear[at]
        raise drive.refusal(
            *(at, "vx", f"position and velocity ({vx:.3g}, {vy:.3g}) contradict each other"),
            f"{bad.mean():.0%} of the drive does; {_what_fits(drive, misfit)}",
        )
    _cut_misfits(drive, rows, bad, "vx", limits)
    _check_vy_sign(drive, limits)


def _what_fits(drive: Drive, misfit: Misfit) -> str:
    """The correction of the velocity that the positions agree with."""
    assert drive.linear is not None
    v = drive.linear
    measured = np.gradient(drive.pose[:, :2], drive.t, axis=0)
    body = turn(measured, -drive.pose[:, 2])
    good = drive.keep & np.isfinite(body).all(-1)
    scale = float((body * v)[good].sum() / max((v[good] ** 2).sum(), 1e-12))
    candidates = {
        "it fits as world-frame velocity: state velocity_frame: world": turn(v, -drive.pose[:, 2]),
        "it fits with vx of the other sign: state signs: {vx: -1}": v * [-1, 1],
        "it fits with both signs turned: state signs: {vx: -1, vy: -1}": -v,
        "it fits with vx and vy exchanged: correct names": v[:, ::-1],
        f"it fits times {scale:.3g}: state units of vx and vy, or of x, y and t": v * scale,
    }
    shares = {text: misfit(candidate)[1].mean() for text, candidate in candidates.items()}
    best = min(shares, key=lambda text: shares[text])
    return best if shares[best] < FITS else "nothing simple fits: set derive_velocity: true"


def _check_vy_sign(drive: Drive, limits: Limits) -> None:
    """The sign of vy by correlation: vy is too small to show in the distance travelled."""
    assert drive.linear is not None
    count = max(1, round(CHORD / drive.period))
    given, derived, rows = [], [], []
    for stretch in drive.stretches():
        if len(stretch) <= count:
            continue
        begin, end = stretch[:-count], stretch[count:]
        yaw = np.unwrap(drive.pose[stretch, 2])
        chord = drive.pose[end, :2] - drive.pose[begin, :2]
        middle = (yaw[:-count] + yaw[count:]) / 2
        time = drive.t[end] - drive.t[begin]
        derived.append(turn(chord, -middle)[:, 1] / time)
        given.append((drive.linear[begin, 1] + drive.linear[end, 1]) / 2)
        rows.append(begin)
    if not rows:
        return
    vy, reference = np.concatenate(given), np.concatenate(derived)
    rms = _rms(reference)
    flipped = _rms(vy + reference)
    if rms > TELLING_VY and flipped < 0.5 * rms and flipped < 0.5 * _rms(vy - reference):
        at = int(np.concatenate(rows)[np.argmax(np.abs(reference))])
        raise drive.refusal(
            *(at, "vy", "position and velocity contradict each other: vy has the other sign"),
            "y points left: state signs: {vy: -1} in a column map",
        )


def _rms(values: ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def check_yaw_rate(drive: Drive, limits: Limits) -> None:
    """The turn equals the integrated yaw rate over 0.5 s.

    Raises:
        RecordingError: It does not in more than isolated places; the message says what would fit.
    """
    rate = drive.yaw_rate
    if rate is None:
        return
    yaw = drive.yaw

    def misfit(candidate: ndarray) -> tuple[ndarray, ndarray]:
        return _misfits(drive, yaw[:, None], candidate[:, None], limits, limits.agreement_angle)

    rows, bad = _at_best_lag(drive, "yaw_rate", rate, misfit, limits)
    if not len(rows) or bad.mean() <= limits.disagreeing_share:
        _cut_misfits(drive, rows, bad, "yaw_rate", limits)
        return
    candidates = {
        "it fits as degrees per second: state units: {yaw_rate: deg/s}": np.radians(rate),
        "it fits with the other sign: state signs: {yaw_rate: -1}": -rate,
    }
    shares = {text: misfit(candidate)[1].mean() for text, candidate in candidates.items()}
    best = min(shares, key=lambda text: shares[text])
    text = best if shares[best] < FITS else "nothing simple fits: ignore the column"
    window = _first_window(drive, rows, bad, limits)
    at = _worst(yaw[:, None], rate[:, None], drive.t, window)
    raise drive.refusal(
        *(at, "yaw_rate", f"yaw and yaw rate ({rate[at]:.3g}) contradict each other"),
        f"{bad.mean():.0%} of the drive does; {text}",
    )


def _misfits(
    drive: Drive, position: ndarray, rate: ndarray, limits: Limits, granted: float
) -> tuple[ndarray, ndarray]:
    """First rows [n] of all windows, and whether position [T, C] and its rate [T, C] disagree.

    |dp - int v dt| > granted + share * max(|dp|, int |v| dt).
    """
    count = max(1, round(limits.agreement_window / drive.period))
    rows, bad = [np.empty(0, int)], [np.empty(0, bool)]
    kept = np.flatnonzero(drive.keep)
    noise = np.sqrt(2) * _noise(position[kept])
    noise += np.sqrt(count) * drive.period * _noise(rate[kept])
    granted += limits.agreement_sigmas * noise
    for stretch in drive.stretches():
        if len(stretch) <= count:
            continue
        t, p, v = drive.t[stretch], position[stretch], rate[stretch]
        moved = p[count:] - p[:-count]
        integral = _integral(v, t, count)
        path = np.maximum(
            np.linalg.norm(moved, axis=-1),
            _integral(np.linalg.norm(v, axis=-1)[:, None], t, count)[:, 0],
        )
        off = np.linalg.norm(moved - integral, axis=-1)
        rows.append(stretch[:-count])
        bad.append(off > granted + limits.agreement_share * path)
    return np.concatenate(rows), np.concatenate(bad)


def _noise(values: ndarray) -> float:
    """Standard deviation of the white noise on a smooth signal [n, C].

    From fourth differences, which a smooth signal hardly has: their variance is 70 times its own
    (1 + 16 + 36 + 16 + 1). The median leaves leaps out.
    """
    if len(values) < 5:
        return 0.0
    fourth = np.linalg.norm(np.diff(values, 4, axis=0), axis=-1)
    return float(1.4826 * np.median(fourth) / np.sqrt(70))


def _at_best_lag(
    drive: Drive, channel: str, rate: ndarray, misfit: Misfit, limits: Limits
) -> tuple[ndarray, ndarray]:
    """The misfit at the lag between the two sensors that explains most; one lag for the drive.

    A velocity that a filter delays is honest: what it is late by is for a diagnosis to find.
    """
    best, best_lag = misfit(rate), 0
    most = int(limits.agreement_lag / drive.period)
    step = max(1, round(0.02 / drive.period))  # [s] finer than any window can tell
    for lag in range(-most, most + 1, step) if best[1].any() else ():
        shifted = rate[np.clip(np.arange(len(rate)) + lag, 0, len(rate) - 1)]
        tried = misfit(shifted)
        if (tried[1].sum(), abs(lag)) < (best[1].sum(), abs(best_lag)):
            best, best_lag = tried, lag
    if best_lag and best[1].mean() <= limits.disagreeing_share:
        way = "late" if best_lag > 0 else "early"
        text = f"agrees with the pose only if it is {abs(best_lag) * drive.period:.2g} s {way}"
        drive.notes.append(f"column {drive.label(channel)!r}: {text}, left as it is")
    return best


def _first_window(drive: Drive, rows: ndarray, bad: ndarray, limits: Limits) -> ndarray:
    """Kept rows of the worst-looking window: the one in the middle of the first bad run."""
    first = int(np.argmax(bad))
    run = int(np.argmin(np.append(bad[first:], False)))
    begin = int(rows[first + run // 2])
    count = max(1, round(limits.agreement_window / drive.period))
    return np.flatnonzero(drive.keep[begin : begin + count + 1]) + begin


def _worst(position: ndarray, rate: ndarray, t: ndarray, rows: ndarray) -> int:
    """The row of a window at which position [T, C] and its rate [T, C] are furthest apart."""
    half = max(1, len(rows) // 10)
    before, after = rows[: -2 * half], rows[2 * half :]
    chord = (position[after] - position[before]) / (t[after] - t[before])[:, None]
    off = np.linalg.norm(chord - rate[rows[half:-half]], axis=-1)
    return int(rows[half + int(np.argmax(off))])


def _integral(v: ndarray, t: ndarray, count: int) -> ndarray:
    """Trapezoidal integral of v [n, C] over each window of `count` steps, [n - count, C]."""
    parts = 0.5 * (v[1:] + v[:-1]) * np.diff(t)[:, None]
    total = np.concatenate([np.zeros((1, v.shape[1])), np.cumsum(parts, 0)])
    return total[count:] - total[:-count]


def _cut_misfits(drive: Drive, rows: ndarray, bad: ndarray, channel: str, limits: Limits) -> None:
    """Cuts the windows in which the two disagree."""
    count = max(1, round(limits.agreement_window / drive.period))
    cut = np.zeros(len(drive.t), bool)
    for row in rows[bad]:
        cut[row : row + count + 1] = True
    drive.cut(cut, channel, "contradicts the pose")
