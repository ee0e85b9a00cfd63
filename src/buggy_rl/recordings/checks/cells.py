"""Single cells: numbers that are none, and quaternions that are none."""

from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.limits import Limits

NEVER_BLANK = ("t", "throttle", "steering")
"""Written by the logger itself, not by a tracker that can lose the car."""


def check_cells(
    file: str, raw: Mapping[str, ndarray], labels: Mapping[str, str], row: ndarray, limits: Limits
) -> dict[str, ndarray]:
    """Cells without a value, by channel, that may be cut: few, and of the tracker.

    Raises:
        RecordingError: An infinity, a missing time or command, or too many missing cells.
    """
    missing = {}
    for channel, values in raw.items():
        infinite, blank = np.isinf(values), np.isnan(values)
        if infinite.any():
            reason = f"the value is {values[np.argmax(infinite)]}"
            remedy = "correct what computes it, or delete the row"
            raise RecordingError(
                file, int(row[np.argmax(infinite)]), labels[channel], reason, remedy
            )
        if not blank.any():
            continue
        first = int(row[np.argmax(blank)])
        if channel in NEVER_BLANK:
            reason, remedy = "no value (NaN)", "delete the row"
            raise RecordingError(file, first, labels[channel], reason, remedy)
        if blank.mean() > limits.missing_share:
            reason = f"no value (NaN) here and in {blank.mean():.0%} of the rows"
            remedy = f"at most {limits.missing_share:.0%} may be missing: record again"
            raise RecordingError(file, first, labels[channel], reason, remedy)
        missing[channel] = blank
    return missing


def check_quaternions(
    file: str, raw: Mapping[str, ndarray], labels: Mapping[str, str], row: ndarray, limits: Limits
) -> None:
    """A quaternion has unit length, and the car stands on its wheels.

    |q| = 1,  cos(tilt) = 1 - 2 (qx^2 + qy^2).

    Raises:
        RecordingError: One has another length, or the car often leans.
    """
    if "qw" not in raw:
        return
    q = np.stack([raw[name] for name in ("qw", "qx", "qy", "qz")], -1)  # (T, 4)
    known = ~np.isnan(q).any(-1)
    norm = np.where(known, np.linalg.norm(q, axis=-1), 1.0)
    bad = np.abs(norm - 1) > limits.quaternion_norm
    columns = ", ".join(labels[name] for name in ("qw", "qx", "qy", "qz"))
    if bad.any():
        first = int(np.argmax(bad))
        raise RecordingError(
            *(file, int(row[first]), columns, f"the quaternion's length is {norm[first]:.4f}"),
            "expected 1: delete the row, or export orientation as a unit quaternion",
        )
    upright = np.where(known, 1 - 2 * (q[:, 1] ** 2 + q[:, 2] ** 2), 1.0)
    leans = upright < np.cos(limits.tilt)
    if leans.mean() > limits.tilt_share:
        first = int(np.argmax(leans))
        tilt = np.degrees(np.arccos(np.clip(upright[first], -1, 1)))
        raise RecordingError(
            *(file, int(row[first]), columns, f"the car leans by {tilt:.0f} degrees"),
            f"{leans.mean():.0%} of the drive does; expected w, x, y, z with the z axis up: "
            "correct the order or turn the frame",
        )
