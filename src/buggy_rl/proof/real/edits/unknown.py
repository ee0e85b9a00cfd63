"""Edits that no effect of the library describes.

The first three are of the car. The last three are of the log: the car got the command itself, and
what was written down is coarser, seldomer or early by a time that comes and goes.
"""

import math
import random
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy import ndarray

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.proof.real.edits.base import (
    DIGITS,
    Edit,
    LogRows,
    log_uniform,
    signed,
    whole_rows,
)

MOST_ROWS = 20  # [rows] longest periodic dead time: 0.2 s
HELD = 0.2  # [s] between the commands of a log at 5 Hz


class UnknownEdit(Edit):
    """An edit without a name in the library."""

    known: ClassVar[bool] = False


class ThrottleExponentEdit(UnknownEdit):
    """A curved throttle: drive = drive'^exponent."""

    name: ClassVar[str] = "throttle_exponent"
    mechanism: ClassVar[str] = "throttle map"
    varies: ClassVar[str] = "throttle"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"exponent": round(math.exp(log_uniform(chance, 0.05, 0.9)), DIGITS)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return rows.with_drive(rows.drive.clip(0) ** (1 / values["exponent"]))


class SteeringExponentEdit(UnknownEdit):
    """A curved steering of a power law: |steering| = |steering'|^exponent; no cubic makes it."""

    name: ClassVar[str] = "steering_exponent"
    mechanism: ClassVar[str] = "steering map"
    varies: ClassVar[str] = "steering"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"exponent": round(math.exp(log_uniform(chance, 0.05, 0.9)), DIGITS)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        size = np.abs(rows.steering) ** (1 / values["exponent"])
        return replace(rows, steering=np.sign(rows.steering) * size)


class CrossTalkEdit(UnknownEdit):
    """Drive that turns the wheels: steering = steering' + share drive."""

    name: ClassVar[str] = "cross_talk"
    mechanism: ClassVar[str] = "cross-talk"
    varies: ClassVar[str] = "throttle"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"share": signed(chance, log_uniform(chance, 0.01, 0.3))}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return replace(rows, steering=rows.steering - values["share"] * rows.drive.clip(0))


class QuantisedLogEdit(UnknownEdit):
    """Commands that were written down in steps."""

    name: ClassVar[str] = "quantised_log"
    mechanism: ClassVar[str] = "log"
    varies: ClassVar[str] = "steering"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"step": round(log_uniform(chance, 0.05, 0.5), DIGITS)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        step = values["step"]
        commands = (rows.throttle, rows.steering)
        throttle, steering = (np.clip(np.round(c / step) * step, -1, 1) for c in commands)
        return replace(rows, throttle=throttle, steering=steering)


class HeldLogEdit(UnknownEdit):
    """Commands that were written down five times a second, and held in between."""

    name: ClassVar[str] = "held_log"
    mechanism: ClassVar[str] = "log"
    varies: ClassVar[str] = "steering"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"phase": round(chance.uniform(0, HELD), DIGITS)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        every, first = round(HELD / rows.dt), round(values["phase"] / rows.dt)
        row = np.arange(len(rows))
        return _read_at(rows, (row - (row + first) % every).clip(0))


class PeriodicDeadTimeEdit(UnknownEdit):
    """Commands that were written down early by up to a dead time, which comes and goes."""

    name: ClassVar[str] = "periodic_dead_time"
    mechanism: ClassVar[str] = "log"
    varies: ClassVar[str] = "steering"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        longest = whole_rows(chance, 2, MOST_ROWS, CONTROL_PERIOD)
        return {"longest": longest, "period": round(chance.uniform(2.0, 10.0), 2)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        share = 0.5 * (1 - np.cos(2 * np.pi * rows.t / values["period"]))
        late = np.round(share * values["longest"] / rows.dt).astype(int)
        kept = max(0, len(rows) - round(values["longest"] / rows.dt))
        return _read_at(rows, np.arange(len(rows)) + late, kept)


def _read_at(rows: LogRows, index: ndarray, kept: int | None = None) -> LogRows:
    """The first rows with the commands of others."""
    own, index = rows.between(0, len(index[:kept])), index[:kept]
    return replace(own, throttle=rows.throttle[index], steering=rows.steering[index])
