"""Which columns are commands and measured rates, in which unit and sign, with the evidence."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from buggy_rl.inspection.signals import (
    EARLIEST,
    ColumnResponse,
    DriveSignals,
    column_response,
    responses,
)
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
LARGEST_RATIO = 1.2  # value above which a command is no ratio
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
    """Unit of the column in the file, where it is not the standard one."""
    sign: float = 1.0
    values: ndarray | None = None
    """[N] of a command, on the grid of the signals."""
    delay: float | None = None
    """Time from a command to what it does [s]."""
    strength: float = 0.0
    """Absolute correlation."""
    centre: float = 0.0
    """Value of a steering command on straight paths."""

    @property
    def middle(self) -> float:
        """The centre, where it is not 0: a servo's pulse stays away from 0, a ratio does not."""
        values = np.empty(0) if self.values is None else self.values[np.isfinite(self.values)]
        return self.centre if len(values) and np.abs(values).min() > 0 else 0.0


def find_steering(signals: DriveSignals) -> Guess | None:
    """The column that the curvature follows.

    A telling name comes first; where the path does not bend with it, but with the column that is
    named as the throttle, both are exchanged.
    """
    found = responses(signals, signals.curvature, signals.moving, 0.0)
    named = _named(found, STEERING)
    # Without a telling name, something that the car follows late is a command, not a measurement.
    late = [r for r in found if r.lag > 0 and not OTHER.search(own_name(r.column))]
    instead = [r for r in _named(found, THROTTLE) if r.lag > 0 and r not in named]
    for r in (*named, *instead) if named else late:
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


def why_no_steering(signals: DriveSignals) -> str:
    """Which column comes nearest to one that the curvature follows."""
    found = responses(signals, signals.curvature, signals.moving, 0.0)
    named = _named(found, STEERING)
    if not found:
        return (
            "the car moves for too short a time" if signals.columns else "no other column changes"
        )
    nearest = (named or found)[0]
    late = "" if nearest.lag > 0 else ", which does not come later, as a measured rate does"
    return (
        f"{'named so is' if named else 'nearest comes'} {nearest.column}, correlation "
        f"{nearest.correlation:+.2f} with the curvature{late} (above {COMMANDS:g} is needed)"
    )


def _named(found: Sequence[ColumnResponse], words: re.Pattern[str]) -> list[ColumnResponse]:
    """Responses of columns, by the last part of their names: `drive.csv` says nothing."""
    return [r for r in found if words.search(own_name(r.column))]


def own_name(column: str) -> str:
    """A column's name, without its table's where it is a number: that of a table says nothing."""
    name = column.rpartition(".")[2]
    return name if name.isdigit() else column


def exchanged(commands: Mapping[str, Guess]) -> bool:
    """Whether each command is in a column that is named as the other."""
    if set(commands) != {"steering", "throttle"}:
        return False
    steering, throttle = (commands[c].column for c in ("steering", "throttle"))
    return bool(
        (THROTTLE.search(steering) and not STEERING.search(steering))
        and (STEERING.search(throttle) and not THROTTLE.search(throttle))
    )


def find_throttle(signals: DriveSignals, steering: Guess | None) -> Guess | None:
    """The column that speed or acceleration follow; `unit` is `m/s` for a speed setpoint."""
    used = steering.column if steering else ""
    table = used.rpartition(".")[0]
    beside = table + "." if table else None  # in a table of their own commands stand together
    instead = (
        bool(used) and not STEERING.search(own_name(used)) and bool(THROTTLE.search(own_name(used)))
    )
    best: tuple[float, Guess] | None = None
    for name in signals.columns:
        named = bool(THROTTLE.search(own_name(name)))
        together = beside is not None and name.startswith(beside)
        other = instead and bool(STEERING.search(own_name(name)))  # each named as the other
        if name == used or not (named or together or other):
            continue
        guess = _throttle(signals, name)
        if guess is not None and (best is None or guess[0] + named > best[0]):
            best = guess[0] + named, guess[1]
    return None if best is None else best[1]


def why_no_throttle(signals: DriveSignals, steering: Guess | None) -> str:
    """Which column comes nearest to one that speed or acceleration follow."""
    used = steering.column if steering else ""
    pulls = responses(signals, signals.acceleration, signals.known, 0.0)
    pulls = [r for r in pulls if r.column != used]
    named = _named(pulls, THROTTLE)
    if not pulls:
        return "no other column changes"
    nearest = max(named or pulls, key=lambda r: abs(r.correlation))
    return (
        f"{'named so is' if named else 'nearest comes'} {nearest.column}, correlation "
        f"{nearest.correlation:+.2f} with the acceleration (above {COMMANDS / 2:g} is needed, or "
        "with the speed)"
    )


def _throttle(signals: DriveSignals, name: str) -> tuple[float, Guess] | None:
    speed = column_response(signals, name, signals.speed, signals.known)
    pull = column_response(signals, name, signals.acceleration, signals.known)
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


def find_rates(signals: DriveSignals, commands: set[str]) -> dict[str, list[Guess]]:
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


def _unit(r: ColumnResponse, factors: Mapping[str, float]) -> str | None:
    """The unit whose factor the slope of a column over its SI signal is nearest to."""
    for unit, factor in factors.items():
        if abs(abs(r.slope) * factor - 1) < UNIT_SLACK:
            return unit
    return None


def _rate(r: ColumnResponse, unit: str, channel: str) -> Guess:
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
