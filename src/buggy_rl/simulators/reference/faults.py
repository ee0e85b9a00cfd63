"""Faults of a car: physics beside its parameters, all neutral by default; the one table of them.

A fault is not among the `PARAMETERS` of a car, so nothing that fits or re-tunes the car changes it.
It is named `effect.parameter`, where the effect is a textbook one by its textbook name. The plants
of other physics have the textbook ones too: `buggy_rl.proof.plants.faults` derives them from it.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import Similarity

TEXTBOOK = (
    # Radio.
    Parameter("throttle_dead_time.dead_time", 0.0, 0.0, 0.3, "s", "Delay of the radio."),
    Parameter("steering_dead_time.dead_time", 0.0, 0.0, 0.3, "s", "Delay of the radio."),
    Parameter("throttle_offset.offset", 0.0, -0.5, 0.5, "-", "Trim of the radio, in command."),
    Parameter("steering_offset.offset", 0.0, -0.5, 0.5, "-", "Trim of the radio, in command."),
    # Servo and linkage.
    Parameter("steering_lag.time_constant", 0.0, 0.0, 0.5, "s", "Lag before the servo's own."),
    # Neutral: beyond the servo's own 12/s.
    Parameter("steering_rate_limit.rate", 100.0, 0.5, 100.0, "1/s", "Fastest motion of the servo."),
    Parameter("steering_gain.gain", 1.0, 0.3, 1.5, "-", "Road-wheel angle over the right one."),
    Parameter("steering_backlash.width", 0.0, 0.0, 0.6, "-", "Play of the rack, in command."),
    Parameter("steering_asymmetry.left_to_right", 1.0, 0.5, 2.0, "-", "Left angles over right."),
    Parameter("servo_stiction.width", 0.0, 0.0, 0.5, "-", "Error that moves a stuck servo."),
    Parameter("steering_dead_zone.width", 0.0, 0.0, 0.4, "-", "Command about the middle, lost."),
    Parameter("steering_curve.curvature", 0.0, -0.4, 0.8, "-", "Share of the cube in the rack."),
    Parameter("steering_end_stop.left_cut", 0.0, 0.0, 0.8, "-", "Rack's way lost on the left."),
    Parameter("steering_end_stop.right_cut", 0.0, 0.0, 0.8, "-", "Rack's way lost on the right."),
    Parameter("steering_play.width", 0.0, 0.0, 0.6, "-", "Play that the tyres take up."),
    # Speed controller, battery and motor.
    Parameter("throttle_lag.time_constant", 0.0, 0.0, 1.0, "s", "Lag of the speed controller."),
    Parameter("throttle_gain.gain", 1.0, 0.3, 1.5, "-", "Duty cycle over the right one."),
    Parameter("throttle_deadband.width", 0.0, 0.0, 0.4, "-", "Drive lost before the car's own."),
    Parameter("voltage_sag.resistance_ratio", 0.0, 0.0, 2.0, "-", "Of the battery, over R_m."),
    Parameter("thermal_foldback.foldback", 0.0, 0.0, 0.9, "-", "Duty cycle lost when hot."),
    Parameter("thermal_foldback.time_constant", 20.0, 1.0, 100.0, "s", "Of that heat."),
    Parameter("brown_out.moving", 0.0, 0.0, 1.0, "-", "Duty cycle lost to a moving servo."),
    Parameter("brown_out.holding", 0.0, 0.0, 1.0, "-", "Duty cycle lost to a servo at lock."),
    Parameter("gear_ratio.ratio", 1.0, 0.5, 2.0, "-", "Turns of the motor over the right ones."),
    Parameter("battery_sag.loss_per_minute", 0.0, 0.0, 0.8, "1/min", "Share of the drive lost."),
    # Neutral: beyond what the motor's own force and speed give.
    Parameter("motor_power_limit.power_per_mass", 1e3, 1.0, 1e3, "W/kg", "Limit at the shaft."),
    Parameter("top_speed.speed_ratio", 1.0, 0.3, 1.5, "-", "No-load speed over the right one."),
    # Resistance.
    Parameter("rolling_resistance.deceleration", 0.0, 0.0, 2.0, "m/s^2", "Dry drag of the wheels."),
    Parameter("viscous_drag.rate", 0.0, 0.0, 2.0, "1/s", "Drag of the bearings over the speed."),
    Parameter("cornering_drag.coefficient", 0.0, 0.0, 0.3, "s^2/m", "Over the square of ay."),
    Parameter("steering_drag.per_angle", 0.0, 0.0, 20.0, "m/(s^2 rad)", "Drag of turned wheels."),
    Parameter("one_sided_drag.yaw_acceleration", 0.0, -30, 30, "rad/s^2", "A bent axle."),
    Parameter("aerodynamic_drag.coefficient", 0.0, 0.0, 0.5, "1/m", "Drag over speed squared."),
    Parameter("yaw_damping.rate", 0.0, 0.0, 20.0, "1/s", "Yaw deceleration over yaw rate."),
    # Differential and driven wheels.
    Parameter("torque_steer.offset", 0.0, -0.05, 0.05, "m", "Of the motor's force, to the left."),
    Parameter("stiff_differential.coupling", 0.0, 0.0, 0.98, "-", "Couple over a locked axle's."),
    # Linkage and suspension.
    Parameter("understeer.gradient", 0.0, -0.006, 0.05, "rad s^2/m", "Turned back by the tyres."),
    Parameter("dive_steer.angle", 0.0, -0.03, 0.03, "rad s^2/m", "Steering by body pitch."),
    # Tyres.
    Parameter("cornering_stiffness.ratio", 1.0, 0.3, 3.0, "-", "Over that of the right tyres."),
    Parameter("tire_grip.grip", 1.0, 0.2, 1.4, "-", "Friction over that of the right tyre."),
    Parameter("grip_balance.front_to_rear", 1.0, 0.5, 2.0, "-", "Front over rear; product kept."),
    Parameter("grip_patch.x", 0.0, -20.0, 20.0, "m", "Centre of the patch, world."),
    Parameter("grip_patch.y", 0.0, -20.0, 20.0, "m", "Centre of the patch, world."),
    Parameter("grip_patch.radius", 0.0, 0.0, 10.0, "m", "Of the patch."),
    Parameter("grip_patch.grip", 1.0, 0.1, 1.5, "-", "Friction on it over that of the floor."),
    # Body and world.
    Parameter("payload.mass_ratio", 1.0, 0.7, 2.0, "-", "Mass with load over the bare car's."),
    Parameter("wind.force_x", 0.0, -2.0, 2.0, "m/s^2", "Force over mass at rest, world x."),
    Parameter("wind.force_y", 0.0, -2.0, 2.0, "m/s^2", "Force over mass at rest, world y."),
    Parameter("floor_slope.along_x", 0.0, -2.0, 2.0, "m/s^2", "Gravity along world x."),
    Parameter("floor_slope.along_y", 0.0, -2.0, 2.0, "m/s^2", "Gravity along world y."),
)

# Physics that no effect describes: the answer to a case with one of them is "unknown".
UNKNOWN = (
    Parameter("sticky_servo.breakaway", 0.0, 0.0, 0.5, "-", "Error that moves a stuck servo."),
    Parameter("bump_steer.angle", 0.0, -0.03, 0.03, "rad s^2/m", "Steering by body roll."),
    Parameter("wheel_wobble.angle", 0.0, 0.0, 0.2, "rad", "Wobble of a bent front left wheel."),
    Parameter("drag_brake.share", 0.0, 0.0, 1.0, "-", "Share of the braking current let through."),
    Parameter("heating_motor.rise", 0.0, 0.0, 0.05, "1/J", "Winding's resistance over its heat."),
    Parameter("loose_differential.time_constant", 0.0, 0.0, 0.5, "s", "Lag of the left half."),
)

# Of a command that is no one-way throttle: fault -> the kind of command that can have it.
COMMAND_OF = {
    "brake_gain": "throttle_brake_reverse",
    "brake_balance": "throttle_brake_reverse",
    "reverse_deadband": "throttle_brake_reverse",
    "drag_brake": "throttle_brake_reverse",
    "speed_controller_lag": "speed",
    "driven_axle_slip": "speed",
    "speed_ramp": "speed",
    "least_speed": "speed",
    "speed_integral": "speed",
}
OF_A_COMMAND = (
    Parameter("brake_gain.gain", 1.0, 0.2, 2.0, "-", "Brake force over the right one."),
    Parameter("brake_balance.shift", 0.0, -1.0, 1.0, "-", "Added to the share in front."),
    Parameter("reverse_deadband.width", 0.0, 0.0, 0.4, "-", "Drive lost before the car's own."),
    Parameter("drag_brake.deceleration", 0.0, 0.0, 5.0, "m/s^2", "Dry brake without a command."),
    Parameter("speed_controller_lag.time_constant", 0.0, 0.0, 0.5, "s", "Of its current."),
    # 1 / (13 g 0.47) = 0.017 for a controller that sees the rear wheels of this car.
    Parameter("driven_axle_slip.slip_per_acceleration", 0.0, 0.0, 0.1, "s^2/m", "Seen slip."),
    # Neutral: beyond the slew of the controller.
    Parameter("speed_ramp.acceleration", 1e3, 0.2, 1e3, "m/s^2", "Fastest setpoint."),
    Parameter("least_speed.speed", 0.0, 0.0, 2.0, "m/s", "Setpoint that is the least obeyed."),
    Parameter("speed_integral.rate", 0.0, 0.0, 10.0, "1/s", "Integral over proportional gain."),
)

FAULTS = (*TEXTBOOK, *UNKNOWN, *OF_A_COMMAND)
NEUTRAL = {fault.name: fault.value for fault in FAULTS}


def effect_of(name: str) -> str:
    """The effect of a fault's name, `effect.parameter`."""
    return name.partition(".")[0]


class Faults:
    """The faults of a batch.

    `faults["wind.force_x"]` is a value; `"wind" in faults` says whether any environment has that
    fault: physics that none has is not computed.

    Args:
        values: Fault name -> value, each [*] or ones in place of the batch; neutral where missing.
        like: Any tensor of the car's; neutral values get its device and type.
    """

    def __init__(self, values: Mapping[str, Tensor], like: Tensor) -> None:
        ones = (1,) * like.dim()
        self._values = {n: like.new_full(ones, v) for n, v in NEUTRAL.items()} | dict(values)
        self.active = frozenset(
            effect_of(name)
            for name, value in values.items()
            if bool((value != NEUTRAL[name]).any())
        )

    def __getitem__(self, name: str) -> Tensor:
        return self._values[name]

    def __contains__(self, effect: object) -> bool:
        return effect in self.active

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self.active))


def flattened(faults: Mapping[str, Any] | TensorDictBase | None) -> dict[str, Any]:
    """Values by `effect.parameter`; given so or nested as `{effect: {parameter: value}}`.

    Raises:
        KeyError: There is no such fault; the message lists those there are.
    """
    flat: dict[str, Any] = {}
    for name, value in () if faults is None else faults.items():
        nested = isinstance(value, Mapping | TensorDictBase)
        flat |= {f"{name}.{key}": v for key, v in value.items()} if nested else {name: value}
    unknown = sorted(set(flat) - set(NEUTRAL))
    if unknown:
        raise KeyError(
            f"the reference car has no fault {', '.join(unknown)}; "
            f"available: {', '.join(sorted(NEUTRAL))}"
        )
    return flat


def as_tensors(
    faults: Mapping[str, Any] | TensorDictBase | None,
    device: torch.device | None,
    similarity: Similarity | None = None,
) -> dict[str, Tensor]:
    """Makes float tensors of faults, each checked against its range.

    Args:
        faults: As `flattened` takes them.
        device: Of the tensors.
        similarity: Ratios of the car to the buggy. A range is the buggy's and that scaled to the
            car together: neutral values, which are the same for all cars, stay within.

    Raises:
        KeyError: There is no such fault.
        ValueError: A value is outside the range of its fault.
    """
    ranges = {fault.name: fault for fault in FAULTS}
    tensors = {}
    for name, value in flattened(faults).items():
        tensor = torch.as_tensor(value, dtype=torch.float32, device=device)
        fault = ranges[name]
        # Single precision does not hold every bound exactly.
        factor = (similarity or Similarity()).of(fault.unit)
        lower, upper = (
            min(fault.lower, factor * fault.lower),
            max(fault.upper, factor * fault.upper),
        )
        room = 1e-6 * (upper - lower)
        outside = ~((tensor >= lower - room) & (tensor <= upper + room))
        if outside.any():
            raise ValueError(
                f"fault {name} is {float(tensor[outside].flatten()[0]):g} {fault.unit}: "
                f"must be in [{lower:g}, {upper:g}]"
            )
        tensors[name] = tensor
    return tensors


def refuse_of_another_command(faults: Faults, kind: str) -> None:
    """Refuses faults that a car with this kind of command cannot have.

    Raises:
        ValueError: There is one.
    """
    for name in sorted(fault.name for fault in OF_A_COMMAND):
        needed = COMMAND_OF[effect_of(name)]
        if needed != kind and bool((faults[name] != NEUTRAL[name]).any()):
            raise ValueError(
                f"fault {name} is one of a car whose command is {needed}; this one's is {kind}: "
                f"give the engine command={needed}"
            )
