"""Which columns are commands and measured rates, in which unit and sign, with the evidence."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.signals import EARLIEST, Response, Signals, response, responses
from buggy_rl.recordings.columns import UNITS

STEERING = re.compile(r"steer|servo|delta|(^|[^a-z])turn|ackermann|angle.?cmd", re.IGNORECASE)
THROTTLE = re.compile(
    r"throttle|pedal|(^|[^a-z])gas|esc($|[^a-z])|duty|motor|drive|(^|\.)V$|speed.?cmd|cmd.?(v|speed)",
    re.IGNORECASE,
)
MEASURED = 0.8  # correlation above which a column measures a rate of the pose; chosen
COMMANDS = 0.4  # correlation above which a column is proposed as a command; chosen
UNIT_SLACK = 0.2  # relative difference of a slope from a unit's factor that still names the unit
SETPOINT = 0.6, 1.4  # slope of speed on a command that is a speed setpoint in m/s
ANGLE = re.compile(r"delta|angle", re.IGNORECASE)
LARGEST_RATIO = 1.2  # value above which a command is no ratio
STANDING = 0.1  # [m/s] speed below which the car stands
AT_ZERO = 0.02  # share of standing rows at a command of exactly 0 that makes 0 its rest; chosen
OFTEN = 0.1  # share of the standing rows at one value that makes it the rest; chosen
OTHER = re.compile(
    r"throttle|pedal|gas|vel|speed|encoder|odom|imu|acc|gyro|rate|yaw|W \(|(^|[._ ])[avw][xyz]?$",
    re.IGNORECASE,
)
"""Names of columns that are no steering command though the path may bend with them."""


@dataclass(frozen=True)
class Guess:
    """A channel of a recording, found in a column."""

    column: str
    """`table.column`."""
    evidence: str
    unit: str = ""
    """Of the file, where it is not the standard one."""
    sign: float = 1.0
    values: ndarray | None = None
    """[N] of a command, on the grid of the signals."""
    delay: float | None = None
    """From a command to what it does [s]."""
    strength: float = 0.0
    """Absolute correlation."""
    centre: float = 0.0
    """Of a steering command: its value on straight paths."""

    @property
    def middle(self) -> float:
        """The centre, where it is not 0: a servo's pulse stays away from 0, a ratio does not."""
        values = np.empty(0) if self.values is None else self.values[np.isfinite(self.values)]
        return self.centre if len(values) and np.abs(values).min() > 0 else 0.0


def find_steering(signals: Signals) -> Guess | None:
    """The column that the curvature follows."""
    found = responses(signals, signals.curvature, signals.moving, 0.0)
    named = [r for r in found if STEERING.search(r.column)]
    # Without a telling name, something that the car follows late is a command, not a measurement.
    late = [r for r in found if r.lag > 0 and not OTHER.search(r.column)]
    for r in named or late:
        if abs(r.correlation) > COMMANDS:
            what = "left" if r.correlation > 0 else "right"
            text = (
                f"the path bends to the {what} with it: correlation {r.correlation:+.2f} with the "
                f"curvature {1000 * r.lag:.0f} ms later"
            )
            sign = 1.0 if r.correlation > 0 else -1.0
            values = signals.columns[r.column]
            return Guess(
                r.column, text, "", sign, values, r.lag, abs(r.correlation), centre=r.offset
            )
    return None


def find_throttle(signals: Signals, steering: Guess | None) -> Guess | None:
    """The column that speed or acceleration follow; `unit` is `m/s` for a speed setpoint."""
    used = steering.column if steering else ""
    table = used.rpartition(".")[0]
    beside = table + "." if table else None  # in a table of their own commands stand together
    best: tuple[float, Guess] | None = None
    for name in signals.columns:
        named = bool(THROTTLE.search(name))
        together = beside is not None and name.startswith(beside)
        if name == used or not (named or together):
            continue
        guess = _throttle(signals, name)
        if guess is not None and (best is None or guess[0] + named > best[0]):
            best = guess[0] + named, guess[1]
    return None if best is None else best[1]


def _throttle(signals: Signals, name: str) -> tuple[float, Guess] | None:
    speed = response(signals, name, signals.speed, signals.known)
    pull = response(signals, name, signals.acceleration, signals.known)
    if speed is None or pull is None:
        return None
    values = signals.columns[name]
    strength = max(speed.correlation, pull.correlation)
    if strength < COMMANDS / 2:
        return None
    inverse = speed.correlation**2 / speed.slope if speed.slope else 0.0  # m/s per command
    setpoint = SETPOINT[0] < inverse / max(speed.correlation, 1e-6) < SETPOINT[1]
    if setpoint and np.nanmax(values) > LARGEST_RATIO and speed.correlation > COMMANDS:
        text = (
            f"a speed setpoint in m/s: the speed goes with it, correlation "
            f"{speed.correlation:+.2f}, {1000 * speed.lag:.0f} ms later"
        )
        return strength, Guess(name, text, "m/s", 1.0, values, speed.lag, strength)
    text = (
        f"correlation {pull.correlation:+.2f} with the acceleration {1000 * pull.lag:.0f} ms "
        f"later, {speed.correlation:+.2f} with the speed"
    )
    return strength, Guess(name, text, "", 1.0, values, pull.lag, abs(pull.correlation))


def find_rates(signals: Signals, commands: set[str]) -> dict[str, list[Guess]]:
    """Columns that measure the speed and the yaw rate, with unit and sign."""
    kinds = {"vx": (signals.speed, "speed"), "yaw_rate": (signals.yaw_rate, "rate")}
    best: dict[str, tuple[float, str, Guess]] = {}  # of each column its best channel
    for channel, (signal, kind) in kinds.items():
        for r in responses(signals, signal, signals.known, EARLIEST):
            unit, strength = _unit(r, UNITS[kind]), abs(r.correlation)
            if r.column in commands or strength < MEASURED or unit is None:
                continue
            if strength > best.get(r.column, (0.0,))[0]:
                best[r.column] = strength, channel, _rate(r, unit, channel)
    ordered = sorted(best.values(), key=lambda entry: -entry[0])
    return {c: [g for _, channel, g in ordered if channel == c] for c in kinds}


def _unit(r: Response, factors: Mapping[str, float]) -> str | None:
    """The unit whose factor the slope of a column over its SI signal is nearest to."""
    for unit, factor in factors.items():
        if abs(abs(r.slope) * factor - 1) < UNIT_SLACK:
            return unit
    return None


def _rate(r: Response, unit: str, channel: str) -> Guess:
    what = "speed" if channel == "vx" else "yaw rate"
    text = (
        f"correlation {r.correlation:+.3f} with the {what} of the pose, {abs(r.slope):.3g} of its "
        f"units in one SI unit"
    )
    return Guess(r.column, text, unit, sign=1.0 if r.slope > 0 else -1.0)


def find_gravity(columns: Mapping[str, ndarray]) -> list[str]:
    """What the vertical acceleration says of an accelerometer's unit, in words."""
    notes = []
    for name, values in columns.items():
        if not re.search(r"a(cc)?[._ ]?z", name, re.IGNORECASE):
            continue
        mean = float(np.nanmean(values))
        if abs(abs(mean) - 1.0) < 0.1:
            notes.append(f"{name}: mean {mean:.3f}, so accelerations there are in g, not m/s^2")
        elif abs(abs(mean) - 9.81) < 0.5:
            notes.append(f"{name}: mean {mean:.2f}, so accelerations there are in m/s^2")
    return notes


def command_range(guess: Guess, signals: Signals) -> dict[str, float]:
    """Ends of a throttle: value at rest, largest, and smallest where it is below rest."""
    assert guess.values is not None
    values = guess.values[np.isfinite(guess.values)]
    still = signals.known & (np.abs(signals.speed) < STANDING) & np.isfinite(guess.values)
    standing = guess.values[still]
    if len(standing) and np.mean(standing == 0) < AT_ZERO:
        rest = _usual(standing)
    else:  # a dead band hides where a ramp's rest is, but nobody rests off a zero that is used
        rest = float(min(values.min(), 0.0)) if not len(standing) else 0.0
    ends = {"rest": rest, "full": float(values.max())}
    if values.min() < rest:
        ends["lowest"] = float(values.min())
    return {name: round(value, 4) for name, value in ends.items()}


def _usual(standing: ndarray) -> float:
    """Command while the car stands: the most frequent one, or the median where none is frequent.

    A car whose stick brakes too often stands under its brake.
    """
    values, counts = np.unique(standing, return_counts=True)
    often = counts.max() > OFTEN * len(standing)
    return float(values[counts.argmax()] if often else np.median(standing))


def steering_range(guess: Guess) -> dict[str, float]:
    """Ends of a steering command: -1 and 1 where it stays within, else the farthest seen.

    A command about another centre, such as a servo's pulse, keeps that centre.
    """
    assert guess.values is not None
    values = guess.values[np.isfinite(guess.values)]
    centre = guess.middle
    most = float(np.abs(values - centre).max())
    most = 1.0 if 0.3 < most <= 1.0 and not ANGLE.search(guess.column) else most
    ends = {"right": centre - guess.sign * most, "left": centre + guess.sign * most}
    return {name: float(f"{value:.5g}") for name, value in ends.items()}
