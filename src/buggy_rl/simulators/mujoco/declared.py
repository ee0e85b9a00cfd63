"""The parameters of the MuJoCo car as shipped.

Hand-tuned values for a small rear-driven buggy, as before there are recordings; not fitted to any
data. Mass, yaw inertia and centre of gravity are those of the car's dimensions; forces and speeds
of another car are the buggy's, scaled.
"""

from collections.abc import Container

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.parameters import Added, Parameter, Realisations, Scaled
from buggy_rl.core.vehicle import Similarity, VehicleDimensions
from buggy_rl.simulators.bicycle.parameters import BRAKES, REPLACED, SHIPPED, SPEED_CONTROL

LONGEST_DEAD_TIME = 0.2  # [s] length of the memory of commands; DART's longest dead time is 0.14 s


def declared_parameters(
    dimensions: VehicleDimensions,
    speed_ratio: float | None = None,
    command: LongitudinalCommand = ONE_WAY,
    brake_front_share: float = 0.0,
) -> list[Parameter]:
    """Every parameter of the MuJoCo car, as shipped.

    Args:
        dimensions: Of the car.
        speed_ratio: Of its speeds to the buggy's; see `Similarity`.
        command: What its first command is.
        brake_front_share: As shipped.
    """
    scale = Similarity.between(dimensions, speed=speed_ratio)
    own = [*_tyres(), *_steering(), *_drive()]
    if command.kind in ("speed", "current"):
        own = [p for p in own if p.name not in REPLACED]
    own += _commanded(command, brake_front_share)
    return [*_body(dimensions), *(scale.scaled(p) for p in own)]


def realised(declared: Container[str]) -> Realisations:
    """Effects that are exactly a change of declared parameters."""
    found = {
        "throttle_dead_time": [Added("throttle_dead_time", "dead_time")],
        "steering_dead_time": [Added("steering_dead_time", "dead_time")],
        "steering_gain": [Scaled("steering_left", "gain"), Scaled("steering_right", "gain")],
        "steering_asymmetry": [
            Scaled("steering_left", "left_to_right", 0.5),
            Scaled("steering_right", "left_to_right", -0.5),
        ],
        "tire_grip": [Scaled("grip_front", "grip"), Scaled("grip_rear", "grip")],
        "grip_balance": [
            Scaled("grip_front", "front_to_rear", 0.5),
            Scaled("grip_rear", "front_to_rear", -0.5),
        ],
        "payload": [Scaled("mass", "mass_ratio")],
        "top_speed": [Scaled("drive_speed_loss", "speed_ratio", -1.0)],
        "gear_ratio": [Scaled("drive_force", "ratio"), Scaled("drive_speed_loss", "ratio", 2.0)],
    }
    return {e: own for e, own in found.items() if all(c.parameter in declared for c in own)}


def _commanded(command: LongitudinalCommand, brake_front_share: float) -> list[Parameter]:
    """Parameters of a command that is no one-way throttle."""
    if command.kind == "speed":
        rows, values = SPEED_CONTROL, SHIPPED
    elif command.kind == "throttle_brake_reverse":
        rows, values = BRAKES, SHIPPED | {"brake_front_share": brake_front_share}
    else:
        return []
    return [Parameter(row[0], values[row[0]], *row[1:]) for row in rows]


def _body(dimensions: VehicleDimensions) -> list[Parameter]:
    mass, inertia, cg = dimensions.mass, dimensions.yaw_inertia, dimensions.cg_to_front_axle
    return [
        Parameter("mass", mass, 0.7 * mass, 1.6 * mass, "kg", "Whole car with wheels and load."),
        Parameter(
            "yaw_inertia",
            inertia,
            0.6 * inertia,
            2.5 * inertia,
            "kg m^2",
            "Whole car about the vertical axis through its centre of gravity.",
        ),
        Parameter(
            "cg_to_front_axle",
            cg,
            0.3 * dimensions.wheelbase,
            0.7 * dimensions.wheelbase,
            "m",
            "Centre of gravity behind the front axle; axles and sensor stay where they are.",
        ),
    ]


def _tyres() -> list[Parameter]:
    return [
        Parameter("grip_front", 0.9, 0.2, 1.6, "-", "Largest tyre force over load, front."),
        Parameter("grip_rear", 0.9, 0.2, 1.6, "-", "Largest tyre force over load, rear."),
        Parameter(
            "cornering_stiffness_front",
            7.0,
            2.0,
            25.0,
            "1/rad",
            "Lateral force over load a radian of slip angle, front; explicit tyres only.",
        ),
        Parameter(
            "cornering_stiffness_rear",
            9.0,
            2.0,
            25.0,
            "1/rad",
            "Lateral force over load a radian of slip angle, rear; explicit tyres only.",
        ),
        Parameter(
            "tyre_shape",
            1.0,
            1.0,
            1.9,
            "-",
            "Pacejka's shape factor: 1 never slides for good, 1.5 loses grip in a slide; explicit "
            "tyres only.",
        ),
    ]


def _steering() -> list[Parameter]:
    longest = LONGEST_DEAD_TIME
    return [
        Parameter("steering_left", 0.36, 0.1, 0.7, "rad", "Wheel angle at full left command."),
        Parameter("steering_right", 0.36, 0.1, 0.7, "rad", "Wheel angle at full right command."),
        Parameter("steering_offset", 0.0, -0.15, 0.15, "rad", "Wheel angle at zero command."),
        Parameter("steering_lag", 0.06, 0.0, 0.4, "s", "Time constant of the servo."),
        Parameter("steering_dead_time", 0.02, 0.0, longest, "s", "Dead time of the servo."),
    ]


def _drive() -> list[Parameter]:
    longest = LONGEST_DEAD_TIME
    return [
        Parameter("throttle_lag", 0.05, 0.0, 0.4, "s", "Time constant of the speed controller."),
        Parameter(
            "throttle_dead_time", 0.02, 0.0, longest, "s", "Dead time of the speed controller."
        ),
        Parameter("throttle_deadband", 0.1, 0.0, 0.4, "-", "Drive in 0..1 below which none acts."),
        Parameter("drive_force", 18.0, 3.0, 50.0, "N", "Full drive at standstill, both wheels."),
        Parameter(
            "drive_speed_loss", 3.5, 0.0, 15.0, "N s/m", "Back-EMF: drive lost a m/s, full drive."
        ),
        Parameter("rolling_resistance", 0.8, 0.0, 5.0, "N", "Whole car, opposes rolling."),
        Parameter("viscous_drag", 0.4, 0.0, 5.0, "N s/m", "Whole car, grows with the speed."),
        Parameter("quadratic_drag", 0.02, 0.0, 1.0, "N s^2/m^2", "Whole car, the air's."),
    ]
