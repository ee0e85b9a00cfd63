"""The heading against the course over ground: degrees, signs, mounting."""

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.drive import Drive, wrap
from buggy_rl.recordings.limits import Limits

WINDOW = 0.2  # [s] chord whose direction is the course; long against noise, short against a turn
STRAIGHT = 0.2  # [rad/s] turning slower than this the lever arm of the tracker moves it little
FITS = 0.95  # mean cosine of a heading that is right, of a car that corners hard at times


def check_heading(drive: Drive, limits: Limits) -> None:
    """The car moves roughly where it points: mean cos(course - yaw) is high while it moves.

    Raises:
        RecordingError: It does not; the message says which correction would fit.
    """
    rows, course, yaw, rate = _courses(drive, limits)
    if len(rows) < 0.5 / drive.period:  # half a second of motion
        return
    offset = float(np.angle(np.exp(1j * (yaw - course)).mean()))  # circular mean
    fits = {
        "as it stands": np.cos(course - yaw),
        "read as degrees": np.cos(course - np.radians(yaw)),
        "with the other sign": np.cos(course + yaw),
        "with x and y exchanged": np.cos(np.pi / 2 - course - yaw),
        "turned": np.cos(course - yaw + offset),
    }
    means = {name: float(cosine.mean()) for name, cosine in fits.items()}
    best = max(means, key=lambda name: means[name])
    looks_like_degrees = (
        np.abs(yaw).max() > 2 * np.pi
        and means["read as degrees"] > FITS
        and means["as it stands"] < FITS
    )
    if means["as it stands"] < limits.heading_agreement or looks_like_degrees:
        at = int(rows[np.argmin(fits["as it stands"])])
        if looks_like_degrees:
            at, best = int(rows[np.argmax(np.abs(yaw))]), "read as degrees"
        raise drive.refusal(at, "yaw", *_verdict(means, best, drive.pose[at, 2], offset))
    _note_mount(drive, limits, course, yaw, rate)


def _verdict(means: dict[str, float], best: str, value: float, offset: float) -> tuple[str, str]:
    reason = (
        f"yaw {value:.4g} does not follow the direction of travel "
        f"(mean cosine {means['as it stands']:.2f})"
    )
    remedies = {
        "read as degrees": "it fits as degrees: state units: {yaw: deg} in a column map",
        "with the other sign": "it fits with the other sign: state signs: {yaw: -1}",
        "with x and y exchanged": "it fits with x and y exchanged: correct names",
        "turned": f"it fits turned: state mount: {{yaw: {offset:.3f}}}",
    }
    if means[best] > FITS and best in remedies:
        return reason, remedies[best]
    return reason, "check unit, sign and mounting of yaw, and which axes x and y are"


def _courses(drive: Drive, limits: Limits) -> tuple[ndarray, ndarray, ndarray, ndarray]:
    """Rows where the car moves, its course [rad], its raw yaw and its turning there [rad/s]."""
    half = max(1, round(WINDOW / 2 / drive.period))
    kept = np.flatnonzero(drive.keep)
    if len(kept) <= 2 * half:
        return np.empty(0, int), np.empty(0), np.empty(0), np.empty(0)
    before, rows, after = kept[: -2 * half], kept[half:-half], kept[2 * half :]
    time = drive.t[after] - drive.t[before]
    chord = drive.pose[after, :2] - drive.pose[before, :2]
    speed = np.linalg.norm(chord, axis=-1) / time
    good = (time < 2 * WINDOW) & (speed > limits.moving_speed) & (speed < limits.top_speed)
    course = np.arctan2(chord[:, 1], chord[:, 0])
    rate = wrap(drive.pose[after, 2] - drive.pose[before, 2]) / time
    return rows[good], course[good], drive.pose[rows[good], 2], rate[good]


def _note_mount(drive: Drive, limits: Limits, course: ndarray, yaw: ndarray, rate: ndarray) -> None:
    straight = np.abs(rate) < STRAIGHT
    if straight.sum() * drive.period < 1.0:  # [s] of straight driving
        return
    off = float(np.median(wrap(course - yaw)[straight]))
    if abs(off) > limits.mount_yaw:
        drive.notes.append(
            f"column {drive.label('yaw')!r}: driving straight the car moves {off:+.3f} rad off its "
            f"heading: if the tracker is mounted so, state mount: {{yaw: {-off:.3f}}}"
        )
