"""What the reference car carries from step to step, as TensorDict keys and as plain tensors."""

from dataclasses import dataclass, field

from torch import Tensor

# The latent state; wheel speeds are kept relative to the ground, so that an edited `velocity`
# takes the wheels with it.
WHEEL_SLIP = "wheel_slip"  # [4] tread speed less ground speed along each wheel [m/s]
TYRE_SLIP = "tyre_slip"  # [2, 4] slip that each carcass carries, along and across [-]
LEAN = "lean"  # [2, 2] acceleration carried by the springs [m/s^2] and its rate, forward and left
SERVO = "servo"  # [1] steering servo in command units
DUTY = "duty"  # [1] duty cycle of the speed controller
CHARGE = "charge"  # [1] charge taken out of the battery since full [A s]

LATENT_SHAPES = {
    WHEEL_SLIP: (4,),
    TYRE_SLIP: (2, 4),
    LEAN: (2, 2),
    SERVO: (1,),
    DUTY: (1,),
    CHARGE: (1,),
}

# Of the faults; each is there only while a car of the batch has the fault.
LINE = "radio_line"  # [K, 2] commands still on their way, newest first
THUMB = "thumb"  # [2] throttle as the speed controller's filter has it, its first lag's first
GOING = "going"  # [1] 1 while a sticky servo moves
RACK = "rack"  # [1] linkage behind its play, in command units
SET_POINT = "set_point"  # [2] steering command as a slow servo has it, likewise
WHEEL_TURN = "wheel_turn"  # [1] of the front left wheel [rad]
HEAT = "heat"  # [1] in the motor's winding [J]
WOUND = "wound"  # [1] motor current as the left half of a loose differential has it [A]

HIDDEN_SHAPES = {
    THUMB: (2,),
    GOING: (1,),
    RACK: (1,),
    SET_POINT: (2,),
    WHEEL_TURN: (1,),
    HEAT: (1,),
    WOUND: (1,),
}
CAUSES = {  # the fault that brings each of them
    THUMB: "throttle_lag",
    GOING: "sticky_servo",
    RACK: "steering_backlash",
    SET_POINT: "steering_lag",
    WHEEL_TURN: "wheel_wobble",
    HEAT: "heating_motor",
    WOUND: "loose_differential",
}


@dataclass(slots=True)
class CarState:
    """What changes from substep to substep; the batch is `*`, wheels as in `wheels`."""

    vx: Tensor  # [*] at the centre of gravity, body frame [m/s]
    vy: Tensor
    yaw_rate: Tensor
    dx: Tensor  # [*] way since the control period began, in the body frame of that moment [m]
    dy: Tensor
    dyaw: Tensor
    tread: Tensor  # [4, *] tread speeds [m/s]
    slip: Tensor  # [2, 4, *]
    lean: Tensor  # [2, *]
    lean_rate: Tensor  # [2, *]
    servo: Tensor  # [*]
    duty: Tensor
    charge: Tensor
    rack: Tensor  # [*] position of the linkage, in command units
    hidden: dict[str, Tensor] = field(default_factory=dict)  # of the faults, each [n, *]


@dataclass(slots=True)
class Setting:
    """What acts on the car during a control period, each [*]."""

    throttle: Tensor  # command
    steering: Tensor
    duty: Tensor  # asked for by the throttle
    voltage: Tensor  # open-circuit [V]
    pose: Tensor  # [*, 3] of the sensor at the start, world frame
