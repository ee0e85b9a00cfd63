"""Clocks that were set while recording, and how long after one another recordings began."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from buggy_rl.core import keys
from buggy_rl.recordings.recording import Recording

CLOCK_ORIGIN = 1e6  # [s] stamps above this, 11 days, count from 1970 and not from a start
LONGEST_PAUSE = 1200.0  # [s] a longer step is a clock that was set: time zones differ by 1800 s
BESIDE = 5  # steps on each side of a jump back that must be regular
# A row in the wrong place makes the 5 steps after it last 6 periods or more, a clock set back 5.
REGULAR = 0.81, 1.19  # mean step beside a jump back, in periods
ADMITTED = 1 / 20  # share of rows at jumps; with more the stamps are in no order


class Jump(NamedTuple):
    """A place at which the clock was set."""

    row: int
    """The first row after it."""
    size: float
    """Time by which the clock was set [s]; negative where it was set back."""

    def __str__(self) -> str:
        way = "back" if self.size < 0 else "forward"
        return f"the clock was set {way} by {abs(self.size):.10g} s"


def unwound(t: ndarray) -> tuple[ndarray, list[Jump]]:
    """Stamps without the jumps of a clock that was set, and the jumps.

    A step back between regular stamps is a jump, and so is one forward that no pause lasts for. The
    rows beside it are taken to be one period apart. Stamps stay those of the last part where it
    counts from 1970, otherwise those of the first.

    Args:
        t: [T] s, finite.

    Returns:
        Stamps [T] s and the jumps; rows in a wrong order stay as they are.
    """
    step = np.diff(t)
    if not (step > 0).any():
        return t, []
    period = float(np.median(step[step > 0]))
    at = [int(i) for i in np.flatnonzero((step < 0) | (step > LONGEST_PAUSE))]
    at = [i for i in at if step[i] > 0 or _between_regular(step, i, period)]
    if not at or len(at) > max(1, ADMITTED * len(t)):
        return t, []
    shift = np.zeros(len(t))
    shift[1:][at] = period - step[at]
    shift = np.cumsum(shift)
    if t[-1] > CLOCK_ORIGIN:
        shift -= shift[-1]
    return t + shift, [Jump(i + 1, float(step[i]) - period) for i in at]


def _between_regular(step: ndarray, at: int, period: float) -> bool:
    """Whether the steps [T - 1] on both sides of one are those of a clock that runs."""
    for side in (step[max(at - BESIDE, 0) : at], step[at + 1 : at + 1 + BESIDE]):
        least, most = (share * period * len(side) for share in REGULAR)
        if not (side > 0).all() or not least <= side.sum() <= most:
            return False
    return True


BREAK = 3600.0  # [s] between two recordings in which a battery is charged or changed; chosen


def place_in_session(recordings: Sequence[Recording]) -> None:
    """Sets `since_first` of recordings whose stamps are on one clock.

    They are where no two of them overlap: files that each begin at 0 do. After a break of over an
    hour a new session begins.
    """
    ordered = sorted(recordings, key=lambda recording: _span(recording)[0])
    spans = [_span(recording) for recording in ordered]
    for recording in ordered:
        recording.since_first = 0.0
    if any(begin <= end for (_, end), (begin, _) in pairwise(spans)):
        return
    first = spans[0][0] if spans else 0.0
    for recording, ((_, end), (begin, _)) in zip(ordered[1:], pairwise(spans), strict=True):
        first = begin if begin - end > BREAK else first
        recording.since_first = begin - first


def _span(recording: Recording) -> tuple[float, float]:
    time = recording.data[keys.TIME]
    return float(time[0, 0]), float(time[-1, 0])
