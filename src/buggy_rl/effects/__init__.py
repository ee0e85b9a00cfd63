"""Missing physics by name: each effect is a transform between engine and task."""

from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from buggy_rl.core import trust
from buggy_rl.core.config import load_named
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.option_values import nearest

if TYPE_CHECKING:  # at run time a name costs no two seconds of torchrl
    from buggy_rl.effects.base import Effect

# In the order of a stack, from the engine outwards. Commands pass it from the far end: radio,
# servo, linkage; speed controller, motor, battery. Effects that read the engine's forces stand
# before those that add to them. A sensor's delays stand before its mounting.
EFFECTS = {
    "battery_sag": "buggy_rl.effects.actuation.throttle:BatterySag",
    "thermal_foldback": "buggy_rl.effects.actuation.supply:ThermalFoldback",
    "brown_out": "buggy_rl.effects.actuation.supply:BrownOut",
    "throttle_gain": "buggy_rl.effects.actuation.throttle:ThrottleGain",
    "throttle_deadband": "buggy_rl.effects.actuation.throttle:ThrottleDeadband",
    "throttle_lag": "buggy_rl.effects.actuation.timing:ThrottleLag",
    "throttle_offset": "buggy_rl.effects.actuation.throttle:ThrottleOffset",
    "throttle_dead_time": "buggy_rl.effects.actuation.timing:ThrottleDeadTime",
    "steering_end_stop": "buggy_rl.effects.actuation.steering:SteeringEndStop",
    "steering_offset": "buggy_rl.effects.actuation.steering:SteeringOffset",
    "steering_gain": "buggy_rl.effects.actuation.steering:SteeringGain",
    "steering_asymmetry": "buggy_rl.effects.actuation.steering:SteeringAsymmetry",
    "steering_curve": "buggy_rl.effects.actuation.steering:SteeringCurve",
    "steering_play": "buggy_rl.effects.actuation.servo:SteeringPlay",
    "steering_backlash": "buggy_rl.effects.actuation.servo:SteeringBacklash",
    "steering_lag": "buggy_rl.effects.actuation.timing:SteeringLag",
    "steering_rate_limit": "buggy_rl.effects.actuation.servo:SteeringRateLimit",
    "servo_stiction": "buggy_rl.effects.actuation.servo:ServoStiction",
    "steering_dead_zone": "buggy_rl.effects.actuation.steering:SteeringDeadZone",
    "steering_dead_time": "buggy_rl.effects.actuation.timing:SteeringDeadTime",
    "understeer": "buggy_rl.effects.tyre.stiffness:Understeer",
    "cornering_stiffness": "buggy_rl.effects.tyre.stiffness:CorneringStiffness",
    "dive_steer": "buggy_rl.effects.tyre.stiffness:DiveSteer",
    "tire_grip": "buggy_rl.effects.tyre.grip:TireGrip",
    "grip_balance": "buggy_rl.effects.tyre.grip:GripBalance",
    "grip_patch": "buggy_rl.effects.tyre.grip:GripPatch",
    "payload": "buggy_rl.effects.motion.drive:Payload",
    "gear_ratio": "buggy_rl.effects.motion.drive:GearRatio",
    "voltage_sag": "buggy_rl.effects.motion.drive:VoltageSag",
    "top_speed": "buggy_rl.effects.motion.drive:TopSpeed",
    "motor_power_limit": "buggy_rl.effects.motion.drive:MotorPowerLimit",
    "steering_drag": "buggy_rl.effects.motion.resistance:SteeringDrag",
    "torque_steer": "buggy_rl.effects.motion.driveline:TorqueSteer",
    "aerodynamic_drag": "buggy_rl.effects.motion.resistance:AerodynamicDrag",
    "rolling_resistance": "buggy_rl.effects.motion.resistance:RollingResistance",
    "viscous_drag": "buggy_rl.effects.motion.resistance:ViscousDrag",
    "cornering_drag": "buggy_rl.effects.motion.resistance:CorneringDrag",
    "floor_slope": "buggy_rl.effects.motion.fields:FloorSlope",
    "wind": "buggy_rl.effects.motion.fields:Wind",
    "one_sided_drag": "buggy_rl.effects.motion.yaw:OneSidedDrag",
    "yaw_damping": "buggy_rl.effects.motion.yaw:YawDamping",
    "stiff_differential": "buggy_rl.effects.motion.driveline:StiffDifferential",
    "sensor_latency": "buggy_rl.effects.sensing.timing:SensorLatency",
    "sensor_lag": "buggy_rl.effects.sensing.timing:SensorLag",
    "sensor_lever_arm": "buggy_rl.effects.sensing.mounting:SensorLeverArm",
    "sensor_yaw": "buggy_rl.effects.sensing.mounting:SensorYaw",
    "heading_drift": "buggy_rl.effects.sensing.mounting:HeadingDrift",
    "pose_scale": "buggy_rl.effects.sensing.mounting:PoseScale",
    "speed_scale": "buggy_rl.effects.sensing.mounting:SpeedScale",
    "gyro_bias": "buggy_rl.effects.sensing.mounting:GyroBias",
}
# Of a command that is no one-way throttle: where it is, the kind that it needs, and the effect of
# `EFFECTS` that it stands behind.
OF_A_COMMAND = {
    "brake_gain": (
        "buggy_rl.effects.actuation.of_a_command:BrakeGain",
        "throttle_brake_reverse",
        "throttle_gain",
    ),
    "reverse_deadband": (
        "buggy_rl.effects.actuation.of_a_command:ReverseDeadband",
        "throttle_brake_reverse",
        "throttle_deadband",
    ),
    "brake_balance": (
        "buggy_rl.effects.motion.of_a_command:BrakeBalance",
        "throttle_brake_reverse",
        "grip_patch",
    ),
    "speed_integral": (
        "buggy_rl.effects.actuation.of_a_command:SpeedIntegral",
        "speed",
        "throttle_gain",
    ),
    "least_speed": (
        "buggy_rl.effects.actuation.of_a_command:LeastSpeed",
        "speed",
        "throttle_lag",
    ),
    "speed_ramp": (
        "buggy_rl.effects.actuation.of_a_command:SpeedRamp",
        "speed",
        "throttle_lag",
    ),
    "speed_controller_lag": (
        "buggy_rl.effects.motion.of_a_command:SpeedControllerLag",
        "speed",
        "motor_power_limit",
    ),
    "driven_axle_slip": (
        "buggy_rl.effects.motion.of_a_command:DrivenAxleSlip",
        "speed",
        "motor_power_limit",
    ),
    "drag_brake": (
        "buggy_rl.effects.motion.of_a_command:DragBrake",
        "throttle_brake_reverse",
        "viscous_drag",
    ),
}
# That show only where the command is a drive: a controller of speed or current makes up for them.
OF_A_DRIVE = ("thermal_foldback", "brown_out", "gear_ratio", "voltage_sag")
OF_A_COLUMN = {"speed_scale": "vx", "gyro_bias": "yaw_rate"}
"""Effects of one sensor -> the column that it measures beside the pose."""
TERMS = ("term.", "terms.")
"""Begin the names of terms, and of banks of them (`effects.terms`)."""
CORRECTIONS = {  # part of a repaired simulator: no diagnosis chooses from them
    "residual_acceleration": "buggy_rl.effects.residual:ResidualAcceleration",
}


STACK = tuple(
    name
    for before in EFFECTS
    for name in (before, *(n for n, (_, _, behind) in OF_A_COMMAND.items() if behind == before))
)
"""All effects, in the order of a stack."""


def offered(command: LongitudinalCommand, derived: Collection[str] = ()) -> list[str]:
    """Effects that a simulator or a recording with this command can have, in their order.

    Args:
        command: Of the car.
        derived: Columns of the velocity that no sensor measured: they follow from the pose, and an
            error of a sensor of theirs cannot be.
    """
    hidden = OF_A_DRIVE if command.kind in ("speed", "current") else ()
    own = [n for n in STACK if n in EFFECTS or OF_A_COMMAND[n][1] == command.kind]
    return [n for n in own if n not in hidden and OF_A_COLUMN.get(n) not in derived]


def effect_class(name: str) -> type["Effect"]:
    """The class of a name in `STACK` or `CORRECTIONS`, or of one's own as `path/file.py:Class`.

    Raises:
        ValueError: There is none (the message lists the known ones), or it is no effect.
    """
    from buggy_rl.effects.base import Effect

    refuse_unknown_effects([name])
    if name.startswith(TERMS):
        from buggy_rl.effects.terms.banks import term_class

        return term_class(name)
    named = {**EFFECTS, **{n: place for n, (place, _, _) in OF_A_COMMAND.items()}, **CORRECTIONS}
    found = load_named(named.get(name, name))
    trust.refuse_other_class(found, Effect, name)
    return found


def refuse_unknown_effects(names: Iterable[str]) -> None:
    """Refuses names of no effect, without importing one.

    Raises:
        ValueError: A name is not in `STACK` or `CORRECTIONS`, nor that of a user's own class.
    """
    for name in names:
        known = name in STACK or name in CORRECTIONS or name.startswith(TERMS)
        if not known and ":" not in name:
            raise ValueError(
                f"no effect {name!r}; {nearest(name, STACK)}available: "
                f"{', '.join(sorted(STACK))}, or your own as file.py:Class"
            )


def make_effect(name: str, values: Mapping[str, Any] | None = None, **options: Any) -> "Effect":
    """Builds an effect from what a user can write in YAML.

    Args:
        name: In `STACK`, or one's own as `path/to/file.py:Class`.
        values: Parameters that are not neutral, and options of the class, by name.
        options: Likewise.

    Raises:
        ValueError: The name, a parameter or a value does not make sense.
    """
    return effect_class(name)(**{**(values or {}), **options})


def make_effects(effects: Mapping[str, Mapping[str, Any] | None]) -> list["Effect"]:
    """Builds effects in their canonical order, whatever the order they are written in.

    Args:
        effects: Name -> parameters and options, as for `make_effect`. One's own stand behind those
            of their kind.

    Returns:
        From the engine outwards, as `make_env` takes them.
    """
    made = {name: make_effect(name, values) for name, values in effects.items()}
    return [made[name] for name in in_order(made)]


def in_order(effects: Mapping[str, "Effect"] | Iterable[str]) -> list[str]:
    """Names of effects from the engine outwards; one's own behind those of their kind."""
    names = list(effects)

    def place(name: str) -> tuple[int, int]:
        if name in STACK or name in CORRECTIONS:
            return position(name), 0
        return position(name, effect_class(name).kind), 1 + names.index(name)

    return sorted(names, key=place)


def position(name: str, kind: str = "") -> int:
    """Position of an effect in a stack, from the engine outwards; corrections stand next to it.

    Args:
        name: In `STACK` or `CORRECTIONS`, or any other with its kind.
        kind: Of a user's own effect, which stands behind the last one of its kind.
    """
    if name in CORRECTIONS:
        return -1
    if name in STACK:
        return STACK.index(name)
    return max(i for i, other in enumerate(STACK) if effect_class(other).kind == kind)
