"""Checks of the time stamps: order, rate, bunches, gaps, and the time left after all cuts."""

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.raw_recording import RawRecording, robust_deviation
from buggy_rl.recordings.recording import Limits

COARSE = 0.3  # share of rows that repeat the stamp before them: its digits do not suffice; chosen
SORTED = 2  # rows out of order, or of one stamp, that are easier deleted one by one; chosen
SLOW_CLOCK = 1.01  # [nominal periods] granted to a clock that runs 1 % slow
THIN = "thin the table to the pose's own rate (one row for each new pose, with its own stamp), "


def check_order(raw: RawRecording, limits: Limits) -> None:
    """Time strictly increases; rows that repeat the stamp and the motion of the next are left out.

    Clocks that were set while recording are no matter of this check: `stamps.unwound`.

    Raises:
        RecordingError: It does not, or there are fewer than three rows.
    """
    if len(raw.t) < 3:
        raise raw.error(len(raw.t) - 1, "t", f"{len(raw.t)} rows; record 3 or more")
    step = np.diff(raw.t)
    _refuse_coarse(raw, step)
    repeated = np.append(step == 0, False) & _same_motion(raw)
    if repeated.any():
        raw.note(np.flatnonzero(repeated), "t", "stamp and motion are those of the next: left out")
        raw.drop(repeated)
        step = np.diff(raw.t)
    if (step > 0).all():
        return
    at = int(np.argmax(step <= 0)) + 1
    does = "stands still" if step[at - 1] == 0 else f"runs back by {-step[at - 1]:.6g} s"
    message = (
        f"time {does} at {raw.t[at]:.6f} s ({int((step <= 0).sum())} such rows); "
        f"{_remedy(raw.t, step)}"
    )
    raise raw.error(at, "t", message)


def _same_motion(raw: RawRecording) -> ndarray:
    """[T] bool: rows whose pose and velocity are those of the next row."""
    same = np.zeros(len(raw.t), bool)
    signals = [raw.pose, raw.linear, raw.yaw_rate]
    parts = [s.reshape(len(raw.t), -1) for s in signals if s is not None]
    values = np.concatenate(parts, -1)
    same[:-1] = (values[1:] == values[:-1]).all(-1)
    return same


def _refuse_coarse(raw: RawRecording, step: ndarray) -> None:
    """Refuses stamps with fewer digits than the rows need."""
    still = float((step == 0).mean())
    if still < COARSE or not (step > 0).any():
        return
    at = int(np.argmax(step == 0)) + 1
    ticks = np.flatnonzero(step > 0)  # the rows between the first and the last tick are whole
    inner = len(ticks) > 1
    rows = ticks[-1] - ticks[0] if inner else len(step)
    rate = rows / (raw.t[ticks[-1]] - raw.t[ticks[0]]) if inner else rows / step.sum()
    message = (
        f"stamps come in steps of {np.median(step[step > 0]):.3g} s, {still:.0%} of the rows have "
        "that of the row before; export more digits, or, if the rows come evenly, state rate: "
        f"{rate:.3g} in a column map (rows a second)"
    )
    raise raw.error(at, "t", message)


def _remedy(t: ndarray, step: ndarray) -> str:
    """What to do about stamps [T] that do not increase: what brings them in order."""
    ordered = np.diff(np.sort(t))
    if (ordered > 0).all() and (step < 0).sum() > SORTED:
        return "the rows are in another order than their stamps: sort the table by them"
    if (step == 0).sum() > SORTED:
        return (
            "rows of one stamp differ: two sources in one column; keep the rows of one of them, "
            "or name its topic"
        )
    return "delete the rows, or stamp at the measurement instead of the delivery"


def check_rate(raw: RawRecording, limits: Limits) -> None:
    """The sample rate is at least `slowest_rate`.

    Raises:
        RecordingError: It is lower.
    """
    if raw.period * limits.slowest_rate <= SLOW_CLOCK:
        return
    rate = 1 / raw.period
    what = "the pose changes at" if raw.repeated.any() else "rows come at"
    message = (
        f"{what} {rate:.3g} Hz (every {raw.period:.4g} s), below slowest_rate "
        f"{limits.slowest_rate:g} Hz; check the unit of t, record faster, or, if this is the "
        f"rate, state limits: {{slowest_rate: {_rounded_down(rate):g}}} in a column map"
    )
    raise raw.error(0, "t", message)


def _rounded_down(rate: float) -> float:
    """A rate [Hz] to two digits, not above it."""
    digit = 10.0 ** (np.floor(np.log10(rate)) - 1)
    return float(np.floor(rate / digit) * digit)


def check_bunched(raw: RawRecording, limits: Limits) -> None:
    """Cuts rows stamped on delivery in a bunch, of which only the last stamp is right."""
    close = np.diff(raw.t, append=np.inf) < limits.bunched_periods * raw.period
    raw.cut(close, "t", "late on delivery, stamped right before the next row")


def check_gaps(raw: RawRecording, limits: Limits) -> None:
    """Finds gaps; they end segments.

    A step is a gap above max(gap_periods, 1 + gap_jitter * jitter) nominal periods, at most
    gap_most, where jitter is the robust relative standard deviation of the steps.
    """
    step = np.diff(raw.t) / raw.period
    jitter = robust_deviation(np.abs(step - 1))
    most = min(max(limits.gap_periods, 1 + limits.gap_jitter * jitter), limits.gap_most)
    raw.longest_step = most * raw.period
    late = np.flatnonzero(step > most)
    if len(late):
        longest = step[late].max() * raw.period
        raw.note(late + 1, "t", f"rows missing before it, up to {longest:.3g} s: cut")


def check_usable_time(raw: RawRecording, limits: Limits) -> None:
    """Enough of the recording remains after all cuts.

    Raises:
        RecordingError: More than `cut_share` of the rows was cut, not counting repeated poses and
            reverse, or less than `shortest_drive` remains.
    """
    first = int(np.argmin(raw.keep))
    last_cut = raw.notes[-1] if raw.notes else "nothing was cut"
    not_lost = raw.repeated | raw.backward
    share = (~raw.keep & ~not_lost).sum() / max((~not_lost).sum(), 1)
    if share > limits.cut_share:
        message = (
            f"{share:.0%} of the rows were cut, above cut_share {limits.cut_share:.0%} "
            f"(last: {last_cut}); record again"
        )
        raise raw.error(first, "t", message)
    spans = [raw.t[s[-1]] - raw.t[s[0]] + raw.period for s in raw.segments()]
    usable = sum(span for span in spans if span >= limits.shortest_segment)
    if usable < limits.shortest_drive - 0.5 * raw.period:
        message = (
            f"{usable:.2f} s usable in segments of {limits.shortest_segment} s or longer "
            f"({last_cut}); {THIN if raw.repeated.any() else ''}record "
            f"{limits.shortest_drive:g} s or longer, or check the unit of t"
        )
        raise raw.error(first, "t", message)
