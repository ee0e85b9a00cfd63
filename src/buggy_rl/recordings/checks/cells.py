"""Checks of single cells: missing values and infinities."""

from collections.abc import Mapping

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.errors import RecordingError
from buggy_rl.recordings.limits import Limits

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
            rows = "delete the row" if blank.sum() == 1 else f"delete these {blank.sum()} rows"
            raise RecordingError(file, f"no value (NaN); {rows}", first, labels[channel])
        if blank.mean() > limits.missing_share:
            message = (
                f"no value (NaN) in {blank.mean():.0%} of the rows exceeds missing_share "
                f"{limits.missing_share:.0%}; state limits: {{missing_share: "
                f"{np.ceil(100 * blank.mean()) / 100:g}}} in a column map to cut these rows, or "
                "record again"
            )
            raise RecordingError(file, message, first, labels[channel])
        missing[channel] = blank
    return missing
