"""Drives that differ from the one asked for; below rest, where a command brakes, nothing does.

A gain of the command is about its neutral: the library's `throttle_gain` is about the drive at
which the simulator's motor begins to give force, which is the same where that is 0.
"""

import random
from collections.abc import Mapping
from typing import ClassVar

from buggy_rl.proof.real.edits.base import DIGITS, Edit, LogRows, log_uniform, ratio

MINUTE = 60.0  # [s]


class ThrottleEdit(Edit):
    """An edit of the drive."""

    mechanism: ClassVar[str] = "throttle map"
    varies: ClassVar[str] = "throttle"


class ThrottleGainEdit(ThrottleEdit):
    """Another gain: drive = gain drive'."""

    name: ClassVar[str] = "throttle_gain"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"gain": ratio(chance, 0.01, 0.4)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return rows.with_drive(rows.drive / values["gain"])


class ThrottleDeadbandEdit(ThrottleEdit):
    """Drive below a width does nothing: drive = (drive' - w) (1 + restored w / (1 - w)).

    A recorded drive of 0 stays 0: any value inside the band gave it.
    """

    name: ClassVar[str] = "throttle_deadband"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        width = round(log_uniform(chance, 0.005, 0.2), DIGITS)
        return {"width": width, "restored": float(chance.random() < 0.5)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        width, restored = values["width"], values["restored"]
        return rows.with_drive(width + rows.drive / (1 + restored * width / (1 - width)))


class BatterySagEdit(ThrottleEdit):
    """A drive that weakens with time: drive = (1 - loss t) drive', t since the recording began."""

    name: ClassVar[str] = "battery_sag"
    speed_too: ClassVar[bool] = False  # its controller makes up for the battery

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"loss_per_minute": round(log_uniform(chance, 0.005, 0.25), DIGITS)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return rows.with_drive(rows.drive / (1 - values["loss_per_minute"] * rows.t / MINUTE))
