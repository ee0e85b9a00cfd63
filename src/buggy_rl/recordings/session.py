"""Recordings of one session: how long after the first of them each one begins."""

from collections.abc import Sequence
from itertools import pairwise

from buggy_rl import keys
from buggy_rl.recordings.recording import Recording

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
