"""Every parameter of the reference car, with unit, range and source; its size and command.

Three kinds of source: *measured*, the dimensions in `vehicle.py`; *DART*, the published set of
the car's mass twin, carried over to this car's laws; *chosen*, a plausible value for parts of
this size, such that the whole car performs like the original (8-10 m/s top speed, wheel spin at
full throttle from rest, a servo lag of 0.05-0.1 s). No chosen value was measured.

A car of another size has the dimensions of its own, and the other values by `similarity`.
"""

from dataclasses import astuple, dataclass, field, fields, replace
from typing import Any

from torch import Tensor

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.parameters import Parameter, Realisations, Scaled
from buggy_rl.core.vehicle import Similarity, VehicleDimensions

DIMENSIONS = VehicleDimensions()

BODY = (
    # Measured: the first four.
    Parameter("mass", DIMENSIONS.mass, 1.2, 2.4, "kg", "Car with battery and computer."),
    Parameter(
        "cg_to_front_axle",
        DIMENSIONS.cg_to_front_axle,
        0.06,
        0.11,
        "m",
        "Centre of gravity behind the front axle.",
    ),
    Parameter(
        "cg_height", DIMENSIONS.cg_height, 0.02, 0.08, "m", "Centre of gravity above the floor."
    ),
    Parameter(
        "yaw_inertia",
        DIMENSIONS.yaw_inertia,
        0.002,
        0.012,
        "kg m^2",
        "Moment of inertia about the vertical axis through the centre of gravity.",
    ),
    # Chosen: frontal area about 0.15 m x 0.14 m, drag coefficient 1, air 1.2 kg/m^3.
    Parameter(
        "aerodynamic_drag", 0.0126, 0.0, 0.1, "kg/m", "Drag force over the square of the speed."
    ),
    # Chosen: soft toy suspension bounces at 4-5 Hz; oil-free dampers.
    Parameter("pitch_frequency", 5.0, 2.0, 12.0, "Hz", "Undamped pitching on the springs."),
    Parameter("roll_frequency", 5.0, 2.0, 12.0, "Hz", "Undamped rolling on the springs."),
    Parameter(
        "suspension_damping", 0.4, 0.1, 1.5, "-", "Damping of pitch and roll over the critical one."
    ),
    Parameter(
        "front_roll_share", 0.5, 0.2, 0.8, "-", "Share of the roll moment the front axle carries."
    ),
)

TYRES = (
    # DART: peak axle friction 0.84 / 0.85.
    Parameter("grip", 0.86, 0.3, 1.3, "-", "Friction of a tyre at its static load, not sliding."),
    # Chosen: rubber on a hard floor loses some friction with load and with sliding speed.
    Parameter(
        "grip_load_loss", 0.08, 0.0, 0.3, "-", "Relative loss of friction per doubling of the load."
    ),
    Parameter(
        "grip_sliding_loss", 0.15, 0.0, 0.5, "-", "Relative loss of friction in a fast slide."
    ),
    Parameter(
        "sliding_speed", 2.0, 0.5, 5.0, "m/s", "Sliding speed at which half that loss has come."
    ),
    # DART: slope of the axle curves at zero slip, B C D = 6.1 and 9.4.
    Parameter(
        "front_cornering_stiffness",
        6.1,
        3.0,
        15.0,
        "1/rad",
        "Lateral force of a front tyre over load and slip, at small slip.",
    ),
    Parameter(
        "rear_cornering_stiffness",
        9.4,
        4.0,
        20.0,
        "1/rad",
        "Lateral force of a rear tyre over load and slip, at small slip.",
    ),
    # Chosen: a tyre is stiffer along than across.
    Parameter(
        "longitudinal_stiffness",
        13.0,
        5.0,
        30.0,
        "-",
        "Longitudinal force of a tyre over load and slip, at small slip.",
    ),
    # Chosen: a little less than the wheel's radius, about which full-size tyres have.
    Parameter(
        "relaxation_length",
        0.025,
        0.01,
        0.1,
        "m",
        "Distance rolled in which a tyre builds up 63 % of its force.",
    ),
    # Chosen: the wheel's springing on its carcass dies out within a few swings.
    Parameter(
        "carcass_damping",
        0.004,
        0.0,
        0.01,
        "s",
        "Damping of the tyre's carcass at a standstill over its stiffness.",
    ),
    # Chosen: soft rubber on a hard floor.
    Parameter(
        "rolling_resistance", 0.03, 0.0, 0.12, "-", "Rolling resistance of a tyre over its load."
    ),
)

DRIVE = (
    # Chosen: a wheel of 40 g, most of it at the rim, on R = 32.5 mm.
    Parameter(
        "wheel_inertia", 2.8e-5, 1e-5, 1e-4, "kg m^2", "One wheel with its share of the axle."
    ),
    # Chosen, the next four: a small brushed motor, 12 m/s without load and 17 A when stalled.
    Parameter("gear_ratio", 6.7, 4.0, 12.0, "-", "Turns of the motor for one of the wheels."),
    Parameter(
        "motor_constant",
        0.0032,
        0.0015,
        0.006,
        "V s/rad",
        "Back-EMF over speed, torque over current.",
    ),
    Parameter("motor_resistance", 0.42, 0.05, 1.0, "ohm", "Winding, brushes and cables."),
    Parameter("rotor_inertia", 2.0e-6, 2e-7, 1e-5, "kg m^2", "The motor's rotor with its pinion."),
    # Chosen, the next three: half the friction DART shows (1.27 N and 0.74 N s/m at low speed),
    # because DART tops out below 5 m/s and this car shall reach 8-10 m/s.
    Parameter(
        "gear_friction",
        0.55,
        0.0,
        2.0,
        "N",
        "Dry friction of motor and gear, as a force at the tread.",
    ),
    Parameter(
        "gear_viscosity",
        0.10,
        0.0,
        1.5,
        "N s/m",
        "Viscous drag of motor and gear, as a force at the tread over the tread's speed.",
    ),
    # A greased open differential; equalises over about 0.1 s when no tyre holds.
    Parameter(
        "differential_viscosity",
        0.25,
        0.0,
        5.0,
        "N s/m",
        "Force between the rear treads over half their difference in speed.",
    ),
    # DART: throttle deadband 0.164.
    Parameter(
        "throttle_deadband", 0.16, 0.0, 0.4, "-", "Drive in 0..1 below which the motor is off."
    ),
    # Chosen: a soft start of 0.12 s.
    Parameter("throttle_slew", 8.0, 1.0, 100.0, "1/s", "Fastest change of the motor's duty cycle."),
)

BATTERY = (
    # Data sheet style: a Li-Po cell gives 4.2 V full and about 3.5 V before its knee.
    Parameter("full_voltage", 8.4, 7.0, 9.0, "V", "Open-circuit voltage of a full battery."),
    Parameter("voltage_drop", 1.4, 0.0, 3.0, "V", "Fall of that voltage until the knee."),
    Parameter("knee_drop", 1.6, 0.0, 4.0, "V", "Further fall at the very end."),
    # Chosen, the next three: 2.2 Ah, two cells at 15 milliohm each and a plug, handed over at 70 %.
    Parameter("capacity", 7920.0, 500.0, 40000.0, "A s", "Charge of a full battery."),
    Parameter("battery_resistance", 0.04, 0.0, 0.3, "ohm", "Inner resistance with the plug."),
    Parameter("initial_charge", 0.7, 0.05, 1.0, "-", "Charge at the start over the capacity."),
    # Chosen: an on-board computer and a camera of about 8 W together.
    Parameter("electronics_current", 1.0, 0.0, 3.0, "A", "What computer and camera draw."),
)

STEERING = (
    # DART: 0.32 rad to the left and 0.40 rad to the right; the middle of it kept, the gap halved.
    Parameter("lock_left", 0.34, 0.2, 0.7, "rad", "Road-wheel angle at full left command."),
    Parameter("lock_right", 0.38, 0.2, 0.7, "rad", "Road-wheel angle at full right command."),
    Parameter("steering_trim", 0.008, -0.1, 0.1, "rad", "Road-wheel angle at zero command."),
    # Chosen: a servo of 0.11 s per 60 degrees, that is 9.5 rad/s, with a horn that turns 0.8 rad.
    Parameter("steering_lag", 0.055, 0.005, 0.25, "s", "Time constant of the servo's last part."),
    Parameter("steering_rate", 12.0, 2.0, 60.0, "1/s", "Fastest change of the steering command."),
    # Chosen: a linkage half way between parallel and Ackermann.
    Parameter("ackermann", 0.5, 0.0, 1.2, "-", "0 parallel front wheels, 1 no scrub in a turn."),
)

PARAMETERS = (*BODY, *TYRES, *DRIVE, *BATTERY, *STEERING)

# Friction of an axle is no parameter: `grip_balance` stays around the car.
REALISES: Realisations = {
    "tire_grip": [Scaled("grip", "grip")],
    "payload": [Scaled("mass", "mass_ratio")],
    "steering_gain": [Scaled("lock_left", "gain"), Scaled("lock_right", "gain")],
    "gear_ratio": [Scaled("gear_ratio", "ratio")],
}

# Of commands that are no one-way throttle. Chosen, as of the single-track car, all but the first
# two: discs on both axles, as 1:5 cars have them, and reverse limited to half.
COMMANDED: dict[str, tuple[Parameter, ...]] = {
    "throttle": (),
    "throttle_brake_reverse": (
        Parameter("brake_front_share", 0.4, 0.0, 1.0, "-", "Share of the brakes in front."),
        Parameter("reverse_share", 0.5, 0.1, 1.0, "-", "Duty cycle in reverse over forward."),
        Parameter("brake_force", 8.0, 1.0, 40.0, "N", "Both axles at full command."),
        Parameter("drag_brake", 0.0, 0.0, 10.0, "N", "Rear axle, without a command."),
        Parameter(
            "reverse_deadband", 0.1, 0.0, 0.4, "-", "Drive that neither brakes nor reverses."
        ),
    ),
    "speed": (
        Parameter("full_speed", 5.0, 1.0, 20.0, "m/s", "Setpoint of a full command."),
        Parameter("speed_gain", 16.0, 2.0, 100.0, "N s/m", "Force over the speed that is missing."),
        # The rear tyres hold 6.5 N standing, less when braked: with more the car spins.
        Parameter("brake_force", 3.0, 1.0, 40.0, "N", "Largest force against the motion."),
        Parameter("pull_force", 5.0, 1.0, 60.0, "N", "Largest force along the motion."),
    ),
    "current": (Parameter("full_current", 15.0, 2.0, 60.0, "A", "Of a full command."),),
}

MEASURED = ("mass", "cg_to_front_axle", "cg_height", "yaw_inertia")  # those of the dimensions
# Times of moving parts, unlike those of electronics: as long as the car's own.
MECHANICAL = ("carcass_damping", "steering_lag")


def declared_parameters(
    kind: str,
    dimensions: VehicleDimensions = DIMENSIONS,
    similarity: Similarity | None = None,
) -> list[Parameter]:
    """Every parameter of a reference car of these dimensions.

    Args:
        kind: Of its first command.
        dimensions: Of the car.
        similarity: Its ratios to the buggy.
    """
    scale = similarity or Similarity()
    result = []
    for p in (*PARAMETERS, *COMMANDED[kind]):
        factor = scale.time if p.name in MECHANICAL else scale.of(p.unit)
        if p.name in MEASURED:
            factor = getattr(dimensions, p.name) / p.value
        result.append(
            replace(p, value=factor * p.value, lower=factor * p.lower, upper=factor * p.upper)
        )
    return result


@dataclass(frozen=True)
class Build:
    """Size and command of a car; those of the buggy by default."""

    dimensions: VehicleDimensions = field(default_factory=VehicleDimensions)
    similarity: Similarity = field(default_factory=Similarity)
    """Ratios to the buggy, by which the constants of the parts are scaled."""
    command: LongitudinalCommand = ONE_WAY
    """What its first command is."""

    @property
    def parts(self) -> tuple[VehicleDimensions, Similarity, LongitudinalCommand]:
        """Fields of the build, in their order."""
        return self.dimensions, self.similarity, self.command

    def numbers(self, like: Tensor) -> Tensor:
        """Dimensions and ratios in one tensor [S] of the type of another."""
        return like.new_tensor((*astuple(self.dimensions), *astuple(self.similarity)))

    @classmethod
    def of_numbers(cls, numbers: Tensor, command: LongitudinalCommand) -> "Build":
        """The inverse of `numbers`, of tensors."""
        own: list[Any] = list(numbers.unbind())
        count = len(fields(VehicleDimensions))
        return cls(VehicleDimensions(*own[:count]), Similarity(*own[count:]), command)

    @property
    def usual(self) -> bool:
        """Whether it is the buggy with a one-way throttle."""
        return self == Build()
