"""What differs between two sets of recordings, measured without any simulator.

Recordings are cut into windows of half a second; each quantity is a median over windows, and its
interval what 95 % of resampled windows give.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.proof.real.edits.base import LogRows, log_rows
from buggy_rl.recordings import Recording

WINDOW = 0.5  # [s]
BEFORE = 1.0  # [s] for which the commands have been as they are in a steady window
HELD = 0.02  # [command] change within which a command is held
MOVING = 0.3  # [m/s]
HIGHEST = 0.1  # share of the windows that are at the limit
BELOW_LIMIT = 2.0  # [m/s^2] lateral acceleration below which tyres hardly slip
STEERED = 0.1  # [command] steering from which a curvature tells a gain
BIN = 0.05  # [command] width of the bins in which equal commands are compared
WIDE_BIN = 0.1  # likewise of the steering, where only its drag matters
LEAST = 3  # windows of a bin
RESAMPLES = 500
Bins = dict[tuple[int, ...], float]
"""Bin of the commands -> a quantity there."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Means over windows, one entry each."""

    speed: ndarray
    """[m/s] forward."""
    lateral: ndarray
    """[m/s^2] speed times yaw rate, its size."""
    curvature: ndarray
    """[1/m] yaw rate over speed."""
    drive: ndarray
    steering: ndarray
    steady: ndarray
    """Whether both commands were held for `BEFORE` and in the window."""

    def __len__(self) -> int:
        return len(self.speed)

    def __getitem__(self, index: ndarray) -> "Windows":
        return Windows(**{name: values[index] for name, values in vars(self).items()})


def cut_windows(recordings: Sequence[Recording]) -> Windows:
    """Windows of recordings in which the car moves.

    Raises:
        ValueError: There are none.
    """
    rows = [row for recording in recordings for part in log_rows(recording) for row in _cut(part)]
    if not rows:
        names = ", ".join(recording.name for recording in recordings)
        raise ValueError(f"{names}: the car moves in no window of {WINDOW:g} s: nothing to measure")
    columns = np.array(rows).T
    names = ("speed", "lateral", "curvature", "drive", "steering", "steady")
    return Windows(**dict(zip(names, columns, strict=True)))


def _cut(part: LogRows) -> Iterator[tuple[float, ...]]:
    length, before = round(WINDOW / part.dt), round(BEFORE / part.dt)
    for first in range(before, len(part) - length + 1, length):
        own, with_past = slice(first, first + length), slice(first - before, first + length)
        speed, rate = part.velocity[own, 0].mean(), part.velocity[own, 2].mean()
        if speed > MOVING:
            held = max(np.ptp(part.throttle[with_past]) / 2, np.ptp(part.steering[with_past]))
            yield (
                *(float(speed), float(abs(speed * rate)), float(rate / speed)),
                *(float(part.drive[own].mean()), float(part.steering[own].mean())),
                float(held < HELD),
            )


def largest_lateral(windows: Windows) -> Bins:
    """Bin of the steering -> median of the windows in which it is highest there [m/s^2].

    It is the limit of the tyres where the throttle went on after they slid.
    """
    return _by_bin(windows.lateral, _highest, windows.steering / BIN)


def speed_at_throttle(windows: Windows) -> Bins:
    """Bins of drive and size of the steering -> median speed under held commands [m/s]."""
    own = windows[windows.steady > 0]
    return _by_bin(own.speed, np.median, own.drive / BIN, np.abs(own.steering) / WIDE_BIN)


def curvature_at_steering(windows: Windows) -> Bins:
    """Bin of the steering -> median curvature, below the limit of the tyres [1/m]."""
    slow = (windows.lateral < BELOW_LIMIT) & (np.abs(windows.steering) > STEERED)
    own = windows[slow & (windows.steady > 0)]
    return _by_bin(np.abs(own.curvature), np.median, own.steering / BIN)


def _highest(values: ndarray) -> float:
    return float(np.median(np.sort(values)[-max(1, round(HIGHEST * len(values))) :]))


def _by_bin(values: ndarray, statistic: Callable, *commands: ndarray) -> Bins:
    """Statistic of the values in each bin of commands, in widths of bins, that has enough."""
    found: dict[tuple[int, ...], list[float]] = {}
    for key, value in zip(np.round(np.stack(commands, -1)).astype(int), values, strict=True):
        found.setdefault(tuple(key.tolist()), []).append(value)
    return {key: float(statistic(np.array(own))) for key, own in found.items() if len(own) >= LEAST}


MEASURES: dict[str, tuple[str, Callable[[Windows], Bins]]] = {
    "largest lateral acceleration at a steering command": ("m/s²", largest_lateral),
    "speed at a throttle and a steering command": ("m/s", speed_at_throttle),
    "curvature at a steering command": ("1/m", curvature_at_steering),
}


@dataclass(frozen=True)
class Measured:
    """A quantity before and after, and the ratio with its 95 % interval."""

    name: str
    unit: str
    before: float
    after: float
    ratio: float
    low: float
    high: float


def measured(baseline: Sequence[Recording], after: Sequence[Recording]) -> list[Measured]:
    """Every quantity of which both sets have windows at equal commands."""
    before, since = cut_windows(baseline), cut_windows(after)
    found = (compared(name, *how, before, since) for name, how in MEASURES.items())
    return [result for result in found if result is not None]


def compared(
    name: str,
    unit: str,
    quantity: Callable[[Windows], Bins],
    before: Windows,
    after: Windows,
) -> Measured | None:
    """A quantity of both; None where they have no bin in common.

    The ratio is the median over the bins that both have, the interval what 95 % of resampled
    windows give.
    """
    values = _in_common(quantity(before), quantity(after))
    if not len(values):
        return None
    chance, drawn = np.random.default_rng(0), []
    for _ in range(RESAMPLES):
        both = [w[chance.integers(0, len(w), len(w))] for w in (before, after)]
        pairs = _in_common(quantity(both[0]), quantity(both[1]))
        if len(pairs):
            drawn.append(_ratio(pairs))
    if not drawn:
        return None
    low, high = np.quantile(drawn, [0.025, 0.975])
    first, second = np.median(values, axis=0)
    return Measured(
        name, unit, float(first), float(second), _ratio(values), float(low), float(high)
    )


def _in_common(before: Bins, after: Bins) -> ndarray:
    """[bins, 2] of what both have."""
    return np.array([(before[b], after[b]) for b in sorted(before.keys() & after.keys())])


def _ratio(values: ndarray) -> float:
    return float(np.median(values[:, 1] / values[:, 0]))
