"""Every parameter of the two bicycle engines: its range, and its value by a preset."""

import importlib.resources
from collections.abc import Mapping, Sequence

import yaml

from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import Similarity, VehicleDimensions

LONGEST_DEAD_TIME = 0.25  # [s] length of the memory `commands`; DART's longest dead time is 0.14 s

# Of each: name, lower, upper, unit, meaning. Ranges are those of the buggy; values are in
# presets/*.yaml, or in `SHIPPED` where a preset leaves them out.
ACTUATION = (
    ("cg_to_front_axle", 0.02, 0.5, "m", "Centre of gravity to front axle."),
    ("cg_to_rear_axle", 0.02, 0.5, "m", "Centre of gravity to rear axle."),
    ("sensor_x", -0.3, 0.3, "m", "Tracking sensor ahead of the centre of gravity."),
    ("sensor_y", -0.3, 0.3, "m", "Tracking sensor to the left of the centre of gravity."),
    ("mass", 0.3, 10.0, "kg", "Mass of the whole car."),
    ("drive_force", 0.0, 100.0, "N", "Force of the motor at standstill and full drive."),
    ("drive_force_loss", 0.0, 20.0, "N s/m", "Force the motor loses to back-EMF per speed."),
    ("throttle_deadband", 0.0, 0.5, "-", "Drive (0..1) below which the motor does nothing."),
    ("dry_friction", 0.0, 10.0, "N", "Friction that does not depend on speed."),
    ("dry_friction_steepness", 0.5, 50.0, "s/m", "Inverse speed at which dry friction is at 76 %."),
    ("viscous_friction", 0.0, 5.0, "N s/m", "Friction that grows with speed."),
    ("quadratic_drag", -0.5, 2.0, "N s^2/m^2", "Resistance that grows with speed squared."),
    ("steering_drag", 0.0, 20.0, "N/rad", "Extra resistance per road-wheel angle."),
    ("steering_drag_speed", 0.0, 10.0, "N s/(m rad)", "Growth of the steering drag with speed."),
    ("steering_drag_free_angle", 0.0, 0.2, "rad", "Road-wheel angle at which that drag begins."),
    ("left_angle", 0.05, 1.0, "rad", "Asymptote of the road-wheel angle to the left."),
    ("left_steepness", 0.1, 5.0, "-", "Steepness of the steering map to the left."),
    ("right_angle", 0.05, 1.0, "rad", "Asymptote of the road-wheel angle to the right."),
    ("right_steepness", 0.1, 5.0, "-", "Steepness of the steering map to the right."),
    ("steering_offset", -0.3, 0.3, "-", "Added to the steering command by the linkage."),
    ("throttle_dead_time", 0.0, LONGEST_DEAD_TIME, "s", "Delay until the throttle acts."),
    ("throttle_lag", 0.0, 1.0, "s", "Time constant of the throttle behind that."),
    ("steering_dead_time", 0.0, LONGEST_DEAD_TIME, "s", "Delay until the steering acts."),
    ("steering_lag", 0.0, 1.0, "s", "Time constant of the steering behind that."),
)
TYRES = (
    ("yaw_inertia", 0.0005, 0.1, "kg m^2", "Inertia about the vertical axis through the cg."),
    ("front_drive_share", 0.0, 1.0, "-", "Share of the wheel force at the front axle."),
    ("front_grip", 0.05, 3.0, "-", "D, largest lateral force of the front axle over its load."),
    ("front_shape", 0.3, 2.5, "-", "C, shape factor of the front axle's magic formula."),
    (
        "front_stiffness",
        0.5,
        60.0,
        "1/rad",
        "B, stiffness factor of the front axle's magic formula.",
    ),
    ("rear_grip", 0.05, 3.0, "-", "D, largest lateral force of the rear axle over its load."),
    ("rear_shape", 0.3, 2.5, "-", "C, shape factor of the rear axle's magic formula."),
    ("rear_stiffness", 0.5, 60.0, "1/rad", "B, stiffness factor of the rear axle's magic formula."),
)
BRAKES = (
    ("brake_force", 0.0, 50.0, "N", "Force of the brakes at full command, against the motion."),
    ("brake_front_share", 0.0, 1.0, "-", "Share of the brake force at the front axle."),
    ("drag_brake", 0.0, 20.0, "N", "Force of the brake without a command, against the motion."),
    ("reverse_share", 0.0, 1.5, "-", "Force of the motor in reverse over that forward."),
    ("reverse_deadband", 0.0, 0.5, "-", "Drive (0..1) of brake and reverse that does nothing."),
)
SPEED_CONTROL = (
    ("full_speed", 0.5, 30.0, "m/s", "Speed setpoint of a full command."),
    ("speed_gain", 0.5, 200.0, "N s/m", "Force of the controller for each m/s that is missing."),
    ("brake_force", 0.0, 50.0, "N", "Largest force of the controller against the motion."),
)
SHIPPED = {
    "brake_force": 8.0,  # [N] 0.5 g of 1.6 kg; chosen
    "brake_front_share": 0.0,  # [-] the motor brakes the rear axle; chosen
    "drag_brake": 0.0,  # [N] off, as controllers are shipped; chosen
    "reverse_share": 0.5,  # [-] controllers limit reverse to about half; chosen
    "reverse_deadband": 0.05,  # [-] as forward in the buggy's preset; chosen
    "full_speed": 5.0,  # [m/s] chosen; a car's file states its own
    "speed_gain": 16.0,  # [N s/m] of 1.6 kg: a time constant of 0.1 s; chosen
}
REPLACED = ("throttle_deadband",)  # parameters of a throttle that a setpoint does not have


def declare(
    preset: str,
    rows: Sequence[tuple],
    dimensions: VehicleDimensions | None = None,
    speed_ratio: float | None = None,
) -> list[Parameter]:
    """Parameters with the values of a preset, or those of another car that is similar to it.

    Args:
        preset: A file in `presets/`, without its ending.
        rows: Name, lower bound, upper bound, unit and meaning of each; bounds are the buggy's.
        dimensions: Of the other car.
        speed_ratio: Of its speeds to the buggy's; see `Similarity`.

    Raises:
        ValueError: There is no such preset, or it leaves a parameter out.
    """
    folder = importlib.resources.files("buggy_rl.simulators") / "presets"
    file = folder / f"{preset}.yaml"
    if not file.is_file():
        available = sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml"))
        raise ValueError(f"no preset {preset!r}; available: {', '.join(available)}")
    values = SHIPPED | yaml.safe_load(file.read_text())["parameters"]
    missing = [row[0] for row in rows if row[0] not in values]
    if missing:
        raise ValueError(f"preset {preset!r} leaves out {', '.join(missing)}: add them to {file}")
    values = {row[0]: float(values[row[0]]) for row in rows}
    if dimensions is None:
        return [Parameter(row[0], values[row[0]], *row[1:]) for row in rows]
    return _similar(values, rows, dimensions, speed_ratio)


def _similar(
    values: Mapping[str, float],
    rows: Sequence[tuple],
    car: VehicleDimensions,
    speed_ratio: float | None,
) -> list[Parameter]:
    """Bounds scaled from the buggy, values from the preset's car; dimensions are the car's own."""
    wheelbase = values["cg_to_front_axle"] + values["cg_to_rear_axle"]
    preset = VehicleDimensions(wheelbase=round(wheelbase, 6), mass=values["mass"])
    to_buggy = Similarity.between(car, speed=speed_ratio)
    speed = to_buggy.speed / Similarity.between(preset).speed
    to_preset = Similarity.between(car, preset, speed)
    own = {
        "mass": car.mass,
        "yaw_inertia": car.yaw_inertia,
        "cg_to_front_axle": car.cg_to_front_axle,
        "cg_to_rear_axle": round(car.cg_to_rear_axle, 9),
        "sensor_x": car.sensor_to_cg,
    }
    result = []
    for name, lower, upper, unit, meaning in rows:
        value, bound = own.get(name, to_preset.of(unit) * values[name]), to_buggy.of(unit)
        result.append(Parameter(name, value, bound * lower, bound * upper, unit, meaning))
    return result
