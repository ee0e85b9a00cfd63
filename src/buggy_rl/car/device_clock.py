"""Stamps of a device's clock -> this computer's monotonic clock, without the jitter of arrival."""

import math
from collections import deque
from typing import Deque

FRAMES = 200  # over which the fastest arrival counts; 1 s of the T265, in which clocks drift 0.1 ms


class DeviceClock:
    """t = stamp + min over the last frames of (arrival - stamp).

    The fastest of the last frames shows the offset of the two clocks and the shortest way; the
    others came later than that, not were measured later. A time is never after its arrival. Where
    the device's clock steps back, times are too old by the step until the frames before it are
    forgotten: a runtime that judges their age stops the car meanwhile.

    Args:
        frames: Kept.
    """

    def __init__(self, frames: int = FRAMES) -> None:
        self._offsets: Deque[float] = deque(maxlen=frames)

    def time(self, stamp: float, arrival: float) -> float:
        """When a frame was measured [s], on the monotonic clock; NaN for a stamp that is none.

        Args:
            stamp: By the device's clock [s].
            arrival: By the monotonic clock [s].
        """
        if not math.isfinite(stamp):
            return math.nan
        self._offsets.append(arrival - stamp)
        return stamp + min(self._offsets)
