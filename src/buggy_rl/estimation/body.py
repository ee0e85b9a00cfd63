"""What a simulator's own parameters can be in a body of known size, and what real cars have.

A fit takes whatever the recordings let it. A yaw inertia absorbs the relaxation of tyres, roll and
a soft servo, an axle's grip a wrong command; each comes out with a narrow interval.
"""

import math
from collections.abc import Mapping
from typing import Any

from buggy_rl.core.car_file import BUGGY_SPEED
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import VehicleDimensions

SLAB = 1.3  # [-] most yaw inertia over that of a uniform slab of the car's outline: masses outboard
GYRATION = (0.6, 1.2)  # [-] k^2 / (a b), radius of gyration and axle distances; of road cars
FRICTION = (0.2, 1.3)  # [-] of a tyre: wet ice to soft rubber on clean asphalt
STEERING_DELAY = (0.02, 0.25)  # [s] of servo and link together
TOP_SPEED = (0.5, 1.5)  # [-] over that of the car's file
GRIPS = ("friction", "front_grip", "rear_grip", "grip")  # names of a tyre's friction in engines


def body_of(simulator: Any) -> VehicleDimensions | None:
    """The body of a simulator that knows it, as engines of ours do."""
    vehicle = getattr(simulator, "vehicle", None)
    found = vehicle() if callable(vehicle) else None
    return found if isinstance(found, VehicleDimensions) else None


def most_yaw_inertia(body: VehicleDimensions) -> float:
    """Largest yaw inertia that a body can have [kg m^2]: SLAB m (length^2 + width^2) / 12."""
    width = body.track_width + body.wheel_width
    return SLAB * body.mass * (body.length**2 + width**2) / 12


def bounded_by(body: VehicleDimensions | None, parameter: Parameter) -> Parameter:
    """A parameter whose range ends at what a body of this size can have."""
    if body is None or parameter.name != "yaw_inertia":
        return parameter
    most = max(most_yaw_inertia(body), parameter.value)
    if most >= parameter.upper:
        return parameter
    p = parameter
    return Parameter(p.name, p.value, p.lower, most, p.unit, p.meaning)


def top_speeds(simulator: Any, values: Mapping[str, float]) -> tuple[float, float] | None:
    """Top speed of a bicycle's motor and resistances, and that of its car's file [m/s].

    drive_force - dry_friction = (drive_force_loss + viscous_friction) v + quadratic_drag v^2; None
    where the simulator has no such motor, or was not made as a car of a file.
    """
    names = ("drive_force", "drive_force_loss", "dry_friction", "viscous_friction")
    if getattr(simulator, "dimensions", None) is None or not set(names) <= set(values):
        return None
    force, loss, dry, viscous = (values[name] for name in names)
    a, b, c = values.get("quadratic_drag", 0.0), loss + viscous, dry - force
    inside = b * b - 4 * a * c
    if inside < 0 or b + math.sqrt(inside) <= 0:  # a drag below 0 pushes: no speed is the top
        return None
    return -2 * c / (b + math.sqrt(inside)), BUGGY_SPEED * simulator.similarity.speed


def implausible(
    values: Mapping[str, float],
    body: VehicleDimensions | None,
    top_speed: tuple[float, float] | None = None,
) -> dict[str, str]:
    """Parameters that no real car has so, each with what is odd of it.

    Args:
        values: All parameters of the simulator, by name.
        body: Its body; None where it is not known.
        top_speed: Of the simulator, and of the car's file [m/s]; None where one is not known.
    """
    found = {}
    inertia = values.get("yaw_inertia")
    if body is not None and inertia is not None:
        mass = values.get("mass", body.mass)
        front = values.get("cg_to_front_axle", body.cg_to_front_axle)
        rear = values.get("cg_to_rear_axle", body.cg_to_rear_axle)
        most, ratio = most_yaw_inertia(body), inertia / (mass * front * rear)
        if inertia >= (1 - 1e-3) * most:
            found["yaw_inertia"] = (
                f"{most:.3g} kg m^2 is the most that a body of {body.length:.2g} x "
                f"{body.track_width + body.wheel_width:.2g} m and {body.mass:.3g} kg can have: it "
                "stands for physics that the simulator lacks (tyre relaxation, roll, a soft "
                "servo), or the car's file has another size (dimensions: length, track_width)"
            )
        elif not GYRATION[0] <= ratio <= GYRATION[1]:
            found["yaw_inertia"] = (
                f"k^2/(ab) is {ratio:.2g}, of cars {GYRATION[0]:g} to {GYRATION[1]:g}: it may "
                "stand for physics that the simulator lacks"
            )
    for name in GRIPS:
        if name in values and not FRICTION[0] <= values[name] <= FRICTION[1]:
            found[name] = (
                f"tyres have {FRICTION[0]:g} to {FRICTION[1]:g}: it may stand for a wrong command, "
                "speed or mass"
            )
    if "steering_dead_time" in values:
        delay = values["steering_dead_time"] + values.get("steering_lag", 0.0)
        if not STEERING_DELAY[0] <= delay <= STEERING_DELAY[1]:
            found["steering_dead_time"] = (
                f"with the lag the steering is {delay:.3g} s late, of cars {STEERING_DELAY[0]:g} "
                f"to {STEERING_DELAY[1]:g} s: compare the clocks of commands and motion"
            )
    if top_speed is not None:
        reached, known = top_speed
        if not TOP_SPEED[0] <= reached / known <= TOP_SPEED[1]:
            found["drive_force"] = (
                f"the top speed is {reached:.2g} m/s, of the car's file {known:.2g} m/s"
            )
    return found
