"""What was driven, what is missing, and what to drive next."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.columns import Guess
from buggy_rl.inspection.drive import DriveFacts
from buggy_rl.inspection.signals import STEP
from buggy_rl.vehicle import GRAVITY

SLOWEST_RATE = 20.0  # [Hz] below which recordings are refused; see `recordings.limits`
LEAST_DRIVES = 3  # a study trains on one, stops training by one, judges by one
LEAST_SECONDS = 60.0  # [s] of motion; the sample study has 9 drives of 45 s
LEAST_SHARE = 0.05  # share of the motion below which something was hardly driven; chosen
LEAST_LATERAL = 0.4  # [g] below which no tyre comes near its limit on any floor; chosen
STANDING = 0.1, 2.0  # [m/s], [s] of standing still that shows a sensor's noise
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
        return np.abs(self.speed) > 3 * STANDING[0]


def coverage(drives: Sequence[DriveFacts], commands: dict[str, Guess]) -> Coverage:
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


def missing(drives: Sequence[DriveFacts], commands: dict[str, Guess]) -> list[str]:
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


def suggestions(seen: Coverage, drives: int) -> Iterator[str]:
    """What to drive next, one line each."""
    moving = seen.moving
    seconds = moving.sum() * STEP
    if drives < LEAST_DRIVES:
        yield f"{drives} drives: record {LEAST_DRIVES} or more, or cut a long one in parts"
    if seconds < LEAST_SECONDS:
        yield f"the car moves for {seconds:.0f} s in all: drive {LEAST_SECONDS:.0f} s or more"
    if not moving.any():
        return
    if (np.abs(seen.speed) < STANDING[0]).sum() * STEP < STANDING[1]:
        yield f"stand still for {STANDING[1]:g} s before a drive: it shows the noise of the sensor"
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
