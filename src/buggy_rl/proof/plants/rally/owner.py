"""What the owner of a rally car knows of it: its measures, and how it is driven about a room."""

import math
from collections.abc import Mapping

from buggy_rl.core.car_file import CarFile, SensorMount, SteeringGeometry
from buggy_rl.policies.controllers.room import RoomConfig
from buggy_rl.proof.plants.rally.body import GRAVITY

STEERED = 0.8  # [-] of full lock in a turn away from a wall, as the room driver has it
USED_GRIP = 0.65  # [-] of the front tyres' friction, counted on: 5.5 m/s^2 of the buggy's 0.85 g
MARGIN = 1.15  # [-] radius counted on over that of slow rolling; chosen


def car_file(numbers: Mapping[str, float]) -> CarFile:
    """What a scale, a tape measure and a protractor say of the unchanged car."""
    length = numbers["wheelbase"]
    dimensions = {
        "mass": numbers["mass"],
        "wheelbase": length,
        "track_width": numbers["track_ratio"] * length,
        "wheel_radius": numbers["radius"],
        "cg_to_front_axle": (1.0 - numbers["front_share"]) * length,
    }
    lock = round(numbers["lock"], 4)
    return CarFile(
        name="rally",
        about="a 1:10 electric buggy",
        dimensions={name: round(value, 4) for name, value in dimensions.items()},
        drive="all" if numbers["four_wheel"] > 0.5 else "rear",
        steering=SteeringGeometry(left=lock, right=lock),
        sensor=SensorMount(ahead=0.0),
    )


def room(numbers: Mapping[str, float]) -> RoomConfig:
    """The room driver's beliefs of a car.

    Slow radius L / tan(0.8 lock), and drive that holds a speed against rolling and back-EMF.
    """
    rolling = numbers["rolling"] * GRAVITY / numbers["stall_acceleration"]
    slow = numbers["wheelbase"] / math.tan(STEERED * numbers["lock"])
    return RoomConfig(
        turning_radius=MARGIN * slow,
        lateral_acceleration=USED_GRIP * numbers["grip"] * GRAVITY,
        drive_at_rest=rolling + numbers["rotor_friction"],
        drive_per_speed=1.0 / (1.1 * numbers["top_speed"]),
    )
