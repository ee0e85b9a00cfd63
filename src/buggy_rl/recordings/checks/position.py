"""Check of positions that are no lengths: degrees of latitude and longitude."""

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.limits import Limits
from buggy_rl.recordings.raw_recording import RawRecording

METRES = 111_195.0  # [m] in a degree of a great circle, of a sphere of 6371 km
CHORD = 0.5  # [s] over which a speed is taken; a receiver with 7 decimals has steps of 1 cm
FARTHEST = 180.0, 90.0  # [degrees] of longitude and latitude
STILL = 0.1  # of `moving_speed`: slower than that in metres, it is not driven; chosen
ALIKE = 0.35  # relative difference of two speeds that are the same; the scale of a sensor is off
FOLLOWS = 0.7  # concentration of course minus heading of a car: 45 degrees of sideslip
DRIVEN = 0.1  # share of the rows that move, in metres, where degrees are driven over; chosen


def check_geographic(raw: RawRecording, limits: Limits) -> None:
    """Positions are in metres, not in degrees of longitude and latitude.

    Raises:
        RecordingError: As metres the car stands still; as degrees it drives, along its heading or
            as fast as its measured velocity says.
    """
    count = raw.rows(CHORD)
    rows = np.flatnonzero(raw.keep & np.isfinite(raw.pose[:, :2]).all(-1))
    if len(rows) <= count:
        return
    xy, t = raw.pose[rows, :2], raw.t[rows]
    if (np.abs(xy).max(0) > FARTHEST).any() and (np.abs(xy[:, ::-1]).max(0) > FARTHEST).any():
        return
    moved = (xy[count:] - xy[:-count]) / (t[count:] - t[:-count])[:, None]
    if np.linalg.norm(moved, axis=-1).max() > STILL * limits.moving_speed:
        return
    latitude = 0 if np.abs(xy[:, 1]).max() > FARTHEST[1] else 1  # its column
    velocity = moved * METRES
    velocity[:, 1 - latitude] *= np.cos(np.radians(np.median(xy[:, latitude])))
    speed = np.linalg.norm(velocity, axis=-1)
    driven = speed > limits.moving_speed
    if driven.mean() < DRIVEN or np.quantile(speed, 0.9) > limits.top_speed:
        return
    middle = rows[count // 2 : count // 2 + len(velocity)]
    if _as_measured(raw, middle, speed) or _follows(velocity[driven], raw.pose[middle[driven], 2]):
        message = (
            f"({xy[0, 0]:.6f}, {xy[0, 1]:.6f}) looks like longitude and latitude in degrees: as "
            f"metres the car stands still, as degrees it drives at {np.median(speed):.2g} m/s; "
            f"project them, for example x = {METRES:.0f} cos(latitude) (longitude "
            f"{-xy[0, 1 - latitude]:+.4f}), y = {METRES:.0f} (latitude {-xy[0, latitude]:+.4f})"
        )
        raise raw.error(int(rows[0]), "x", message)


def _as_measured(raw: RawRecording, rows: ndarray, speed: ndarray) -> bool:
    """Whether speeds [n] at rows [n] are those of the measured velocity."""
    if raw.linear is None:
        return False
    measured = np.linalg.norm(raw.linear[rows], axis=-1)
    return bool(np.median(np.abs(speed - measured)) < ALIKE * np.median(speed))


def _follows(velocity: ndarray, yaw: ndarray) -> bool:
    """Whether a heading [n], of any unit, sign and origin, is that of a velocity [n, 2]."""
    course = np.arctan2(velocity[:, 1], velocity[:, 0])
    off = [course - sign * unit * yaw for sign in (1, -1) for unit in (1.0, np.radians(1.0))]
    concentration = max(float(np.abs(np.exp(1j * angle).mean())) for angle in off)
    return concentration > FOLLOWS
