"""Conditions of a drive and readings of the sensor in words, for sentences and for the report."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Condition:
    """A quantity of what was driven."""

    words: str
    """Words in a sentence."""
    unit: str = ""
    listed: str = ""
    """Words in the report's list of regions; empty for `words`."""
    listed_unit: str = ""
    """The unit there; empty for `unit`."""
    scale: float = 1.0
    """How many of the unit of the report are 1 of what is computed with."""
    varying: str = ""
    """Words for a segment's mean, with which an effect's numbers vary; empty for `words`."""


CONDITIONS = {
    "vx": Condition("speed", "m/s"),
    "acceleration": Condition("longitudinal acceleration", "m/s^2"),
    "throttle": Condition("throttle", listed="throttle command"),
    "steering": Condition(
        "steering", listed="steering command", varying="the side that is steered to"
    ),
    "abs_steering": Condition("the magnitude of the steering command"),
    "steering_rate": Condition(
        "steering rate", "1/s", listed_unit="commands/s", varying="how fast the steering moves"
    ),
    "lateral_acceleration": Condition(
        "lateral acceleration", "m/s^2", varying="the side of the lateral acceleration"
    ),
    "abs_lateral_acceleration": Condition("lateral acceleration", "m/s^2"),
    "heading": Condition("heading", "°", scale=180 / math.pi),
    "heading_x": Condition("heading"),
    "heading_y": Condition("heading"),
    "elapsed": Condition("time since the start", "s"),
    "x": Condition("position", "m", listed="position x"),
    "y": Condition("position", "m", listed="position y"),
}
"""Name of `residuals.drive_features`, or of `constancy.conditions` -> its words."""


@dataclass(frozen=True)
class ReadingWords:
    """A reading of the sensor."""

    words: str
    unit: str
    fault: str = ""
    """Words for what a simulator gets wrong to one side; empty for `words`."""
    listed: str = ""
    """Words in the report; empty for `words`."""


READINGS = {
    "x": ReadingWords("longitudinal position", "m"),
    "y": ReadingWords("lateral position", "m"),
    "yaw": ReadingWords("heading", "rad"),
    "vx": ReadingWords("longitudinal speed", "m/s", "speed", "longitudinal speed (vx)"),
    "vy": ReadingWords("lateral speed", "m/s", listed="lateral speed (vy)"),
    "yaw_rate": ReadingWords("yaw rate", "rad/s"),
}
