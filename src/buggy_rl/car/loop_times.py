"""How long the steps of the loop took: a histogram of fixed size."""

import math
from typing import List

BIN = 1e-5  # [s] width of a bin: a tenth of a step of 0.1 ms
BINS = 5000  # up to 50 ms, five control periods; longer steps share the last bin


class LoopTimes:
    """Counts durations [s]; memory and time of a count do not grow with the drive."""

    def __init__(self) -> None:
        self._counts: List[int] = [0] * (BINS + 1)
        self.count = 0
        self.longest = 0.0
        """The longest duration [s]."""

    def add(self, seconds: float) -> None:
        """Counts one duration."""
        self._counts[min(int(seconds / BIN), BINS)] += 1
        self.count += 1
        self.longest = max(self.longest, seconds)

    def quantile(self, share: float) -> float:
        """Least bin edge [s] that `share` of the durations do not exceed; NaN without any."""
        if not self.count:
            return math.nan
        left = math.ceil(share * self.count)
        for index, count in enumerate(self._counts):
            left -= count
            if left <= 0:
                return min((index + 1) * BIN, self.longest) if index < BINS else self.longest
        return self.longest
