"""Checks of single cells: missing values, infinities, invalid quaternions."""

from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.limits import Limits

QUATERNION = ("qw", "qx", "qy", "qz")
NEVER_MISSING = ("t", "throttle", "steering")
"""Channels of the logger itself; only a tracker can lose the car."""


def check_cells(
    file: str, raw: Mapping[str, ndarray], labels: Mapping[str, str], row: ndarray, limits: Limits
) -> dict[str, ndarray]:
    """Returns the missing cells [T] of the tracker's channels, few enough to be cut.

    Raises:
        RecordingError: An infinity, a missing time or command, or too many missing cells.
    """
    missing = {}
    for channel, values in raw.items():
        infinite, blank = np.isinf(values), np.isnan(values)
        if infinite.any():
            at = int(np.argmax(infinite))
            message = f"{values[at]}; correct the value or delete the row"
            raise RecordingError(file, message, int(row[at]), labels[channel])
        if not blank.any():
            continue
        first = int(row[np.argmax(blank)])
        if channel in NEVER_MISSING:
            raise RecordingError(file, "no value (NaN); delete the row", first, labels[channel])
        if blank.mean() > limits.missing_share:
            message = (
                f"no value (NaN) in {blank.mean():.0%} of the rows exceeds missing_share "
                f"{limits.missing_share:.0%}; record again"
            )
            raise RecordingError(file, message, first, labels[channel])
        missing[channel] = blank
    return missing


def check_quaternions(
    file: str, raw: Mapping[str, ndarray], labels: Mapping[str, str], row: ndarray, limits: Limits
) -> None:
    """Quaternions have unit length and the car is upright.

    |q| = 1,  cos(tilt) = 1 - 2 (qx^2 + qy^2).

    Raises:
        RecordingError: A length differs from 1, or more than `tilt_share` of the rows is tilted.
    """
    if "qw" not in raw:
        return
    q = np.stack([raw[name] for name in QUATERNION], -1)  # (T, 4)
    known = ~np.isnan(q).any(-1)
    columns = ", ".join(labels[name] for name in QUATERNION)
    norm = np.where(known, np.linalg.norm(q, axis=-1), 1.0)
    bad = np.abs(norm - 1) > limits.quaternion_norm
    if bad.any():
        at = int(np.argmax(bad))
        message = f"quaternion length {norm[at]:.4f} is not 1; delete the row or export unit length"
        raise RecordingError(file, message, int(row[at]), columns)
    upright = np.where(known, 1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2), 1.0)
    tilted = upright < np.cos(limits.tilt)
    if tilted.mean() > limits.tilt_share:
        at = int(np.argmax(tilted))
        tilt = np.degrees(np.arccos(np.clip(upright[at], -1, 1)))
        message = (
            f"tilt of {tilt:.0f} degrees, in {tilted.mean():.0%} of the rows; correct the order "
            "(expected w, x, y, z) or the frame (expected z up)"
        )
        raise RecordingError(file, message, int(row[at]), columns)
