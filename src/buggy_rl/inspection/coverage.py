"""What was driven, which ends the commands reached, what is missing, what to drive next."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.inspection.columns import Guess
from buggy_rl.inspection.drive import DriveFacts
from buggy_rl.inspection.signals import STEP

SLOWEST_RATE = 20.0  # [Hz] below which recordings are refused; see `recordings.limits`
LEAST_DRIVES = 3  # a study trains on one, stops training by one, judges by one
LEAST_SECONDS = 60.0  # [s] of motion; the sample study has 9 drives of 45 s
LEAST_SHARE = 0.05  # share of the motion below which something was hardly driven; chosen
LEAST_LATERAL = 0.4  # [g] below which no tyre comes near its limit on any floor; chosen
STANDSTILL = 0.1, 2.0  # [m/s], [s] of standing still that shows a sensor's noise
HIGH = 0.8  # share of the largest command above which it is full


@dataclass(frozen=True)
class Coverage:
    """All drives together, N instants with a known pose."""

    speed: ndarray
    """[N] m/s."""
    lateral: ndarray
    """[N] lateral acceleration, speed times yaw rate [m/s^2]."""
    steering: ndarray
    """[N] in the file's unit, from its centre, positive to the left; NaN where there is none."""
    throttle: ndarray
    """[N] in the file's unit."""

    @property
    def moving(self) -> ndarray:
        """[N] whether the car moves."""
        return np.abs(self.speed) > 3 * STANDSTILL[0]


def command_coverage(drives: Sequence[DriveFacts], commands: dict[str, Guess]) -> Coverage:
    """Puts the drives together.

    Args:
        drives: Some may have no pose.
        commands: Channel -> the column that was chosen for it.
    """
    parts: dict[str, list[ndarray]] = {k: [np.empty(0)] for k in ("v", "a", "s", "u")}
    for signals in (d.signals for d in drives if d.signals is not None):
        known, missing = signals.known, np.full(len(signals.t), np.nan)
        parts["v"].append(signals.speed[known])
        parts["a"].append((signals.speed * signals.yaw_rate)[known])
        for key, channel in (("s", "steering"), ("u", "throttle")):
            guess = commands.get(channel)
            values = missing if guess is None else signals.columns.get(guess.column, missing)
            if guess is not None:
                values = guess.sign * (values - guess.middle)
            parts[key].append(values[known])
    return Coverage(*(np.concatenate(parts[key]) for key in ("v", "a", "s", "u")))


def missing_in_files(drives: Sequence[DriveFacts], commands: dict[str, Guess]) -> list[str]:
    """What the files lack, one line each."""
    found = []
    for channel in (c for c in ("steering", "throttle") if c not in commands):
        why = next((d.reasons[channel] for d in drives if channel in d.reasons), "no pose")
        found.append(f"no column was found for {channel}: {why}")
    lost = [d for d in drives if d.pose is None]
    if lost:
        names = ", ".join(d.name for d in lost[:5])
        why = next((d.reasons["pose"] for d in lost if "pose" in d.reasons), "it cannot be read")
        found.append(f"{len(lost)} drives without a pose: {names}: {why}")
    slow = [d for d in drives if d.pose and 1 / d.pose.clock.period < SLOWEST_RATE]
    if slow:
        rate = min(1 / d.pose.clock.period for d in slow if d.pose)
        found.append(
            f"poses of {len(slow)} drives come below {SLOWEST_RATE:g} Hz (down to {rate:.3g} Hz): "
            f"they need limits: {{slowest_rate: {np.floor(rate):g}}}"
        )
    return found


def drive_suggestions(seen: Coverage, drives: int) -> Iterator[str]:
    """What to drive next, one line each."""
    moving = seen.moving
    seconds = moving.sum() * STEP
    if drives < LEAST_DRIVES:
        yield f"{drives} drives: record {LEAST_DRIVES} or more, or cut a long one in parts"
    if seconds < LEAST_SECONDS:
        yield f"the car moves for {seconds:.0f} s in all: drive {LEAST_SECONDS:.0f} s or more"
    if not moving.any():
        return
    if (np.abs(seen.speed) < STANDSTILL[0]).sum() * STEP < STANDSTILL[1]:
        seconds = STANDSTILL[1]
        yield f"stand still for {seconds:g} s before a drive: it shows the noise of the sensor"
    lateral = float(np.quantile(np.abs(seen.lateral[moving]), 0.99)) / GRAVITY
    if lateral < LEAST_LATERAL:
        yield (
            f"lateral acceleration stays below {lateral:.2f} g: drive circles faster, until the "
            "tyres slide, to see their grip"
        )
    backward = float((seen.speed[moving] < 0).mean())
    if backward > LEAST_SHARE:
        yield (
            f"{backward:.0%} of the motion is reverse, which is cut out unless the column map "
            "declares a command with reverse"
        )
    yield from _steering(seen.steering[moving])
    yield from _throttle(seen.throttle[moving])


def _steering(steering: ndarray) -> Iterator[str]:
    steering = steering[np.isfinite(steering)]
    if not len(steering) or not np.ptp(steering):
        return
    most = np.abs(steering).max()
    for side, sign in (("left", 1), ("right", -1)):
        share = float((sign * steering > 0.1 * most).mean())
        if share < LEAST_SHARE:
            yield f"hardly steered to the {side} ({share:.0%} of the motion): drive both ways round"


def _throttle(throttle: ndarray) -> Iterator[str]:
    throttle = throttle[np.isfinite(throttle)]
    if not len(throttle) or not np.ptp(throttle):
        return
    most, least = throttle.max(), throttle.min()
    full = float((throttle > least + HIGH * (most - least)).mean())
    if full < LEAST_SHARE / 5:
        yield f"near the largest command for {full:.1%} of the motion only: full-command straights"
    idle = float((throttle < least + 0.1 * (most - least)).mean())
    if idle < LEAST_SHARE / 5:
        yield "the car hardly coasts: let go of the throttle at speed, to see drag and friction"


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


def seen_at_rest(drives: Sequence[DriveFacts], guess: Guess) -> bool:
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
