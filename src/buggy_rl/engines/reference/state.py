"""What the reference car carries from step to step, as TensorDict keys and as plain tensors."""

from dataclasses import dataclass

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


@dataclass(slots=True)
class Setting:
    """What stays the same during a control period, each [*]."""

    steering: Tensor  # command
    duty: Tensor  # asked for by the throttle
    voltage: Tensor  # open-circuit [V]
    slope_x: Tensor  # pull of the floor in the body frame at the start [m/s^2]
    slope_y: Tensor
