"""The ends of a command's range: those that the data show, and those that were only reached."""

import re
from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.columns import Guess
from buggy_rl.inspection.drive import DriveFacts

ANGLE = re.compile(r"delta|angle", re.IGNORECASE)
STANDING = 0.1  # [m/s] speed below which the car stands
AT_ZERO = 0.02  # share of standing rows at a command of exactly 0 that makes 0 its rest; chosen
OFTEN = 0.1  # share of the standing rows at one value that makes it the rest; chosen
SMOOTH = 20  # different values, below which a command is one of steps; chosen
CLIPPED, TIMES = 0.01, 5.0  # share of the rows, and times the usual one, at a value that is an end
RATIO = (
    0.7,
    1.0,
)  # largest magnitude of a command that is a ratio of -1 to 1; no wheel turns 0.7 rad
UNKNOWN = '"???"'  # in a column map: a value that has to be written before it is read


def throttle_ends(drives: Sequence[DriveFacts], guess: Guess) -> dict[str, str]:
    """`rest`, `full` and, where it goes below rest, `lowest` of a throttle, as YAML."""
    values = _values([d.throttle for d in drives], guess.column)
    standing = np.concatenate([np.empty(0), *(_standing(d, guess.column) for d in drives)])
    ratio = guess.unit != "m/s" and _is_ratio(values)
    rest = _rest(standing, values)
    ends = {"rest": rest, "full": 1.0 if ratio else _end(values, float(values.max()))}
    if rest is not None and values.min() < rest:
        ends["lowest"] = -1.0 if ratio else _end(values, float(values.min()))
    return {name: _written(value) for name, value in ends.items()}


def steering_ends(drives: Sequence[DriveFacts], guess: Guess) -> dict[str, str]:
    """`right` and `left` of a steering command, as YAML.

    -1 and 1 of a ratio.
    """
    values = _values([d.steering for d in drives], guess.column)
    if _is_ratio(values) and not ANGLE.search(guess.column):
        ends: list[float | None] = [-1.0, 1.0]
    else:
        ends = [_end(values, float(values.min())), _end(values, float(values.max()))]
    right, left = ends if guess.sign > 0 else ends[::-1]
    return {"right": _written(right), "left": _written(left)}


def stands(drives: Sequence[DriveFacts], guess: Guess) -> bool:
    """Whether the car is seen to stand, so that the value at rest is."""
    return any(len(_standing(drive, guess.column)) for drive in drives)


def seen(drives: Sequence[DriveFacts], channel: str, guess: Guess) -> str:
    """Smallest and largest value of a command, in words; of the steering with their sides."""
    values = _values([getattr(d, channel) for d in drives], guess.column)
    low, high = (f"{value:.5g}" for value in (values.min(), values.max()))
    if channel == "throttle":
        return f"seen: {low} to {high}"
    right, left = (low, high) if guess.sign > 0 else (high, low)
    return f"seen: right {right}, left {left}"


def is_end(values: ndarray, value: float) -> bool:
    """Whether a command [N] that goes no farther than a value has its end there.

    A command that is clipped stays at its end many times as long as at any other value; one of a
    few steps stays at each of them, and says nothing of its ends.
    """
    found, count = np.unique(np.round(values, 6), return_counts=True)
    at = int(count[np.abs(found - value) <= 1e-4 * max(1.0, abs(value))].sum())
    return (
        len(found) >= SMOOTH and at > CLIPPED * len(values) and at > TIMES * float(np.median(count))
    )


def _is_ratio(values: ndarray) -> bool:
    return bool(RATIO[0] < np.abs(values).max() <= RATIO[1])


def _end(values: ndarray, value: float) -> float | None:
    return value if is_end(values, value) else None


def _written(value: float | None) -> str:
    return UNKNOWN if value is None else f"{value:.5g}"


def _values(guesses: Sequence[Guess | None], column: str) -> ndarray:
    """Values [N] of a command in all drives in which it is that column."""
    same = [g.values for g in guesses if g is not None and g.column == column]
    values = np.concatenate([np.empty(0), *(v for v in same if v is not None)])
    return values[np.isfinite(values)]


def _standing(drive: DriveFacts, column: str) -> ndarray:
    """Values [n] of a throttle while the car stands."""
    guess, signals = drive.throttle, drive.signals
    if guess is None or signals is None or guess.column != column or guess.values is None:
        return np.empty(0)
    still = signals.known & (np.abs(signals.speed) < STANDING) & np.isfinite(guess.values)
    return guess.values[still]


def _rest(standing: ndarray, values: ndarray) -> float | None:
    """Raw value without drive; None where the car never stands and no 0 or -1 is an end."""
    if len(standing) and np.mean(standing == 0) < AT_ZERO:
        return _usual(standing)
    # A dead band hides where a ramp's rest is, but nobody rests off a zero that is used.
    if len(standing) or (values == 0).any():
        return 0.0
    return -1.0 if values.min() == -1 else None


def _usual(standing: ndarray) -> float:
    """Command while the car stands: the most frequent one, or the median where none is frequent.

    A car whose stick brakes too often stands under its brake.
    """
    values, counts = np.unique(standing, return_counts=True)
    often = counts.max() > OFTEN * len(standing)
    return float(values[counts.argmax()] if often else np.median(standing))
