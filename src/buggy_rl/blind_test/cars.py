"""Cars of other sizes than the buggy, similar to it."""

import math
from dataclasses import replace
from typing import Any

from buggy_rl.car_file import BUGGY_SPEED, CarFile, CarLimits
from buggy_rl.longitudinal import LongitudinalCommand
from buggy_rl.vehicle import VehicleDimensions

BUGGY = 1.0  # scale of the buggy itself, a car of 1:10
FULL_SPEED = 5.0  # [m/s] setpoint of a full speed command, of the reference car as shipped


def car_of(scale: float, command: LongitudinalCommand) -> CarFile:
    """A car of the buggy's shape and density.

    Args:
        scale: Its length over the buggy's: 2 is 1:5, 10 is full size.
        command: What its first command is.
    """
    buggy, speed = VehicleDimensions(), math.sqrt(scale)
    if command.kind == "speed":
        command = replace(command, full_speed=FULL_SPEED * speed)
    return CarFile(
        name=f"buggy_times_{scale:g}",
        about="a scaled buggy",
        dimensions={"mass": buggy.mass * scale**3, "wheelbase": buggy.wheelbase * scale},
        limits=CarLimits(top_speed=BUGGY_SPEED * speed),
        command=command,
    )


def written(car: CarFile) -> dict[str, Any]:
    """The content of the file of such a car."""
    speed = {} if car.command.full_speed is None else {"full_speed": car.command.full_speed}
    return {
        "about": car.about,
        "dimensions": dict(car.dimensions),
        "limits": {"top_speed": car.limits.top_speed},
        "command": car.command.plain_fields | speed,
    }
