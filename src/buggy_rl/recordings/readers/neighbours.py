"""Values of one source at the stamps of another."""

import numpy as np
from numpy import ndarray


def last_before(stamps: ndarray, values: ndarray, at: ndarray) -> ndarray:
    """Values at or before times [N]; before the first stamp, where `near` is false, the first."""
    return values[np.maximum(np.searchsorted(stamps, at, side="right") - 1, 0)]


def interpolated(
    channel: str, stamps: ndarray, values: ndarray, at: ndarray, turn: float = 2 * np.pi
) -> ndarray:
    """Values [N] between neighbours in time, linear; a yaw is not interpolated across its wrap.

    Args:
        channel: `yaw`, or another.
        stamps: [T] s, increasing.
        values: [T].
        at: [N] s.
        turn: A whole turn in the unit of a yaw.
    """
    if channel == "yaw":
        values = np.unwrap(values, period=turn)
    return np.interp(at, stamps, values)


def near(stamps: ndarray, at: ndarray, hold: float, last: bool) -> ndarray:
    """Whether times [N] have a stamp within `hold` [s] before them and, unless `last`, after."""
    index = np.searchsorted(stamps, at, side="right")
    before = np.where(index > 0, at - stamps[np.maximum(index - 1, 0)], np.inf)
    after = np.where(index < len(stamps), stamps[np.minimum(index, len(stamps) - 1)] - at, np.inf)
    return (before <= hold) & (last | (before == 0) | (after <= hold))
