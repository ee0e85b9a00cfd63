"""What can be wrong with the reference car, beside its parameters; all of it off by default.

A fault is physics of this car and stands apart from `PARAMETERS`: what fits and re-tunes the car
never sees it, so that a drive with a fault is a riddle whose answer is known. Named as
`effect.parameter`; where the effect is a textbook one, by its textbook name.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.parameters import Parameter

COMMANDS = (
    Parameter("throttle_dead_time.dead_time", 0.0, 0.0, 0.3, "s", "The radio hands it on late."),
    Parameter("steering_dead_time.dead_time", 0.0, 0.0, 0.3, "s", "The radio hands it on late."),
    Parameter("throttle_offset.offset", 0.0, -0.5, 0.5, "-", "Trim of the radio, in command."),
    Parameter("steering_offset.offset", 0.0, -0.5, 0.5, "-", "Trim of the radio, in command."),
)

STEERING = (
    Parameter("steering_lag.time_constant", 0.0, 0.0, 0.5, "s", "A slow servo's smoothing."),
    # Neutral far above what the servo does by itself.
    Parameter("steering_rate_limit.rate", 100.0, 0.5, 100.0, "1/s", "Fastest motion of the servo."),
    Parameter("steering_gain.gain", 1.0, 0.3, 1.5, "-", "Length of the servo horn, relative."),
    Parameter("steering_backlash.width", 0.0, 0.0, 0.6, "-", "Play of the rack, in command."),
    Parameter("steering_asymmetry.left_to_right", 1.0, 0.5, 2.0, "-", "Left angles over right."),
    Parameter("sticky_servo.breakaway", 0.0, 0.0, 0.5, "-", "Error that moves a stuck servo."),
    Parameter("bump_steer.angle", 0.0, -0.03, 0.03, "rad s^2/m", "Steering by leaning."),
    Parameter("wheel_wobble.angle", 0.0, 0.0, 0.2, "rad", "Wobble of a bent front left wheel."),
)

DRIVE = (
    Parameter("throttle_lag.time_constant", 0.0, 0.0, 1.0, "s", "Filter of the speed controller."),
    Parameter("throttle_gain.gain", 1.0, 0.3, 1.5, "-", "Duty cycle given over the right one."),
    Parameter("throttle_deadband.width", 0.0, 0.0, 0.4, "-", "Drive lost before the car's own."),
    Parameter("battery_sag.loss_per_minute", 0.0, 0.0, 0.8, "1/min", "Voltage lost in driving."),
    # Neutral far above what the motor does by itself.
    Parameter("motor_power_limit.power_per_mass", 1e3, 1.0, 1e3, "W/kg", "Limit at the shaft."),
    Parameter("top_speed.speed_ratio", 1.0, 0.3, 1.5, "-", "Free speed of another winding."),
    Parameter("drag_brake.share", 0.0, 0.0, 1.0, "-", "Share of the braking current let through."),
    Parameter("heating_motor.rise", 0.0, 0.0, 0.05, "1/J", "Winding's resistance over its heat."),
    Parameter("loose_differential.time_constant", 0.0, 0.0, 0.5, "s", "Lateness of the left half."),
)

WHEELS = (
    Parameter("rolling_resistance.deceleration", 0.0, 0.0, 2.0, "m/s^2", "Dry drag of the wheels."),
    Parameter("viscous_drag.rate", 0.0, 0.0, 2.0, "1/s", "Drag of the bearings over the speed."),
    Parameter("cornering_drag.coefficient", 0.0, 0.0, 1.0, "-", "Drag over the side force."),
    Parameter("one_sided_drag.yaw_acceleration", 0.0, -30, 30, "rad/s^2", "A bent axle."),
)

TYRES = (
    Parameter("tire_grip.grip", 1.0, 0.2, 1.4, "-", "Friction over that of the right tyre."),
    Parameter("grip_balance.front_to_rear", 1.0, 0.5, 2.0, "-", "Front over rear; product kept."),
    Parameter("grip_patch.x", 0.0, -20.0, 20.0, "m", "Middle of the patch in the world."),
    Parameter("grip_patch.y", 0.0, -20.0, 20.0, "m", "Middle of the patch in the world."),
    Parameter("grip_patch.radius", 0.0, 0.0, 10.0, "m", "Of the patch."),
    Parameter("grip_patch.grip", 1.0, 0.1, 1.5, "-", "Friction on it over that of the floor."),
)

BODY = (
    Parameter("payload.mass_ratio", 1.0, 0.7, 2.0, "-", "Mass on the floor over the bare car's."),
    Parameter("aerodynamic_drag.coefficient", 0.0, 0.0, 0.5, "1/m", "Slowing over speed squared."),
    Parameter("wind.force_x", 0.0, -2.0, 2.0, "m/s^2", "Push on a standing car over its mass."),
    Parameter("wind.force_y", 0.0, -2.0, 2.0, "m/s^2", "Push on a standing car over its mass."),
    Parameter("floor_slope.along_x", 0.0, -2.0, 2.0, "m/s^2", "Gravity along world x."),
    Parameter("floor_slope.along_y", 0.0, -2.0, 2.0, "m/s^2", "Gravity along world y."),
    Parameter("yaw_damping.rate", 0.0, 0.0, 20.0, "1/s", "Scrubbing against the yaw rate."),
)

FAULTS = (*COMMANDS, *STEERING, *DRIVE, *WHEELS, *TYRES, *BODY)
NEUTRAL = {fault.name: fault.value for fault in FAULTS}


class Faults:
    """The faults of a batch of cars.

    `faults["wind.force_x"]` is a value, `"wind" in faults` says whether any car has that fault:
    physics that no car needs is not computed.

    Args:
        values: Fault name -> value, each [*] or ones in place of the batch; neutral where missing.
        like: Any tensor of the car's; its device and type are those of neutral values.
    """

    def __init__(self, values: Mapping[str, Tensor], like: Tensor) -> None:
        ones = (1,) * like.dim()
        self._values = {n: like.new_full(ones, v) for n, v in NEUTRAL.items()} | dict(values)
        self.active = frozenset(
            name.partition(".")[0]
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
    """Values by `effect.parameter`, of what may be nested as `{effect: {parameter: value}}`.

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
    faults: Mapping[str, Any] | TensorDictBase | None, device: torch.device | None
) -> dict[str, Tensor]:
    """The same as float tensors, each checked against its range.

    Raises:
        KeyError: There is no such fault.
        ValueError: A value is outside the range of its fault.
    """
    ranges = {fault.name: fault for fault in FAULTS}
    tensors = {}
    for name, value in flattened(faults).items():
        tensor = torch.as_tensor(value, dtype=torch.float32, device=device)
        fault = ranges[name]
        # A hair of room: single precision does not hold every bound.
        room = 1e-6 * (fault.upper - fault.lower)
        outside = ~((tensor >= fault.lower - room) & (tensor <= fault.upper + room))
        if outside.any():
            raise ValueError(
                f"fault {name} is {float(tensor[outside].flatten()[0]):g} {fault.unit}: "
                f"must be in [{fault.lower:g}, {fault.upper:g}]"
            )
        tensors[name] = tensor
    return tensors
