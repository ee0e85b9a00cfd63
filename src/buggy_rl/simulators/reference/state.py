"""The latent state of the reference car, as TensorDict keys and as plain tensors."""

from dataclasses import dataclass, field

from torch import Tensor

# Wheel speeds are relative to the ground, so that an edit of `velocity` changes them too.
WHEEL_SLIP = "wheel_slip"  # [4] tread speed less ground speed along each wheel [m/s]
TYRE_SLIP = "tyre_slip"  # [2, 4] slip of each carcass, along and across [-]
LEAN = "lean"  # [2, 2] pitch and roll, as the acceleration [m/s^2] they balance, and its rate
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

# Of the faults; each is there only while an environment of the batch has the fault.
LINE = "radio_line"  # [K, 2] commands of the last periods, newest first
THROTTLE_LAG = "lagged_throttle"  # [2] throttle behind the two stages of the speed controller's lag
SERVO_MOVES = "servo_moves"  # [1] 1 while a sticky servo moves
STICKS = "servo_sticks"  # [1] 1 while a servo with stiction moves
RACK = "rack"  # [1] linkage behind its play, in command units
SET_POINT = "set_point"  # [2] steering command behind the two stages of a further lag
WHEEL_TURN = "wheel_turn"  # [1] angle of the front left wheel about its axle [rad]
HEAT = "heat"  # [1] in the motor's winding [J]
CONTROLLER = "controller_current"  # [2] current behind the stages of a speed controller's lag [A]
SUPPLY_HEAT = "supply_heat"  # [1] of a controller that limits by it, 1 at full drive for ever [-]
SPEED_SUM = "speed_sum"  # [1] setpoint that the integral of a speed controller adds [m/s]
GIVES = "linkage_gives"  # [1] angle by which the front wheels are turned back [rad]
LEFT_CURRENT = "left_current"  # [1] motor current at the left half of a loose differential [A]

FAULT_STATES: dict[str, tuple[tuple[int, ...], str]] = {  # shape, and the fault that has it
    THROTTLE_LAG: ((2,), "throttle_lag"),
    SERVO_MOVES: ((1,), "sticky_servo"),
    STICKS: ((1,), "servo_stiction"),
    RACK: ((1,), "steering_backlash"),
    SET_POINT: ((2,), "steering_lag"),
    WHEEL_TURN: ((1,), "wheel_wobble"),
    HEAT: ((1,), "heating_motor"),
    GIVES: ((1,), "understeer"),
    LEFT_CURRENT: ((1,), "loose_differential"),
    SUPPLY_HEAT: ((1,), "thermal_foldback"),
    SPEED_SUM: ((1,), "speed_integral"),
    CONTROLLER: ((2,), "speed_controller_lag"),
}


@dataclass(slots=True)
class CarState:
    """State from substep to substep; the batch is `*`, the axis of wheels as in `tyres`."""

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
    fault_state: dict[str, Tensor] = field(default_factory=dict)  # of the faults, each [n, *]


@dataclass(slots=True)
class Setting:
    """Inputs of the car during a control period, each [*]."""

    throttle: Tensor  # command
    steering: Tensor
    duty: Tensor  # by the throttle
    voltage: Tensor  # open-circuit [V]
    pose: Tensor  # [*, 3] of the sensor at the start, world frame
