"""Linkages that turn the wheels by another angle than the steering says."""

import random
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy import ndarray

from buggy_rl.proof.real.edits.base import DIGITS, Edit, LogRows, log_uniform, ratio, signed


class SteeringEdit(Edit):
    """An edit of the steering."""

    mechanism: ClassVar[str] = "steering map"
    varies: ClassVar[str] = "steering"


class SteeringOffsetEdit(SteeringEdit):
    """Wheels that are not straight at 0: steering = steering' + offset."""

    name: ClassVar[str] = "steering_offset"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"offset": signed(chance, log_uniform(chance, 0.005, 0.2))}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return replace(rows, steering=rows.steering - values["offset"])


class SteeringGainEdit(SteeringEdit):
    """Another gain: steering = gain steering'."""

    name: ClassVar[str] = "steering_gain"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"gain": ratio(chance, 0.01, 0.4)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return replace(rows, steering=rows.steering / values["gain"])


class SteeringAsymmetryEdit(SteeringEdit):
    """Gains sqrt(q) to the left and 1 / sqrt(q) to the right."""

    name: ClassVar[str] = "steering_asymmetry"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"left_to_right": ratio(chance, 0.02, 0.5)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        root = values["left_to_right"] ** 0.5
        steering = np.where(rows.steering > 0, rows.steering / root, rows.steering * root)
        return replace(rows, steering=steering)


class SteeringBacklashEdit(SteeringEdit):
    """Play between command and wheels: steering' = steering + width / 2, the way it moves.

    Exact of a play ahead of the servo's lag; at a reversal the command jumps by the width within a
    row, as that of a driver who takes up the play would not.
    """

    name: ClassVar[str] = "steering_backlash"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"width": round(log_uniform(chance, 0.01, 0.25), DIGITS)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        taken_up = values["width"] / 2 * last_direction(rows.steering)
        return replace(rows, steering=rows.steering + taken_up)


def last_direction(values: ndarray) -> ndarray:
    """[T] sign of the last change up to each row; 0 before the first."""
    change = np.sign(np.diff(values, prepend=values[:1]))
    moved = np.maximum.accumulate(np.where(change != 0, np.arange(len(values)), 0))
    return change[moved]
