"""Longitudinal forces of the two bicycle engines: motor, brakes and resistance."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.engines.speed_control import REPLACED, SPEED_CONTROL, controlled_force
from buggy_rl.engines.steering_map import LEFT_RIGHT_BLEND
from buggy_rl.engines.two_way import (
    BRAKES,
    braking_force,
    current_force,
    esc_drive,
    rolling_forward,
    setpoint_force,
)
from buggy_rl.longitudinal import LongitudinalCommand

STEERING_DRAG_ONSET = 0.3  # [m/s] speed at which steering drag begins; dart_dynamic_models.py
STEERING_DRAG_STEEPNESS = 20.0  # [s/m] of that onset; dart_dynamic_models.py

DriveForce = Callable[[Tensor, Tensor, Mapping[str, Tensor]], Tensor]
"""Force [*] N at a speed [*] m/s and a drive [*], by parameter values."""


def motor_force(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of a DC motor: F = (f0 - f1 vx) max(0, drive - deadband), drive in 0..1.

    Source: DART, Lyons et al., dart_dynamic_models.py, with a corner for its tanh(100 .).
    """
    available = values["drive_force"] - values["drive_force_loss"] * vx
    return available * (drive - values["throttle_deadband"]).clamp_min(0)


def resistance(vx: Tensor, steering_angle: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N against the motion, friction and the extra drag of steered wheels.

    F = a tanh(b vx) + c vx + d vx |vx| + g(vx) (e + f |vx|) (delta tanh(30 delta) - free angle),
    with g = 0 at rest and +-1 in motion. Where the sum would drive the car, as with a negative
    `quadratic_drag` at high speed, the force is 0.

    Source: DART, Lyons et al., dart_dynamic_models.py, made odd in vx.
    """
    speed = vx.abs()
    onset, steepness = STEERING_DRAG_ONSET, STEERING_DRAG_STEEPNESS
    moving = 0.5 * (torch.tanh(steepness * (vx - onset)) + torch.tanh(steepness * (vx + onset)))
    bend = steering_angle * torch.tanh(LEFT_RIGHT_BLEND * steering_angle)
    force = (
        values["dry_friction"] * torch.tanh(values["dry_friction_steepness"] * vx)
        + values["viscous_friction"] * vx
        + values["quadratic_drag"] * vx * speed
        + moving
        * (values["steering_drag"] + values["steering_drag_speed"] * speed)
        * (bend - values["steering_drag_free_angle"])
    )
    return torch.where(force * vx > 0, force, torch.zeros_like(force))


def two_way_drive(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of the motor behind a two-way ESC; see `two_way.esc_drive`."""
    return esc_drive(vx, rolling_forward(vx), drive, values)


def two_way_setpoint(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of a speed controller with reverse; see `two_way.setpoint_force`."""
    return setpoint_force(vx, None, drive, values)


def commanded_current(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of a commanded current; see `two_way.current_force`."""
    return current_force(vx, None, drive, values)


@dataclass(frozen=True)
class LongitudinalLaw:
    """Motor and brakes of one kind of command."""

    drive: DriveForce = motor_force
    """Of the motor, shared between the axles as the drive is."""
    brake: DriveForce | None = None
    """Of brakes with a share of their own; None where the motor's force is all there is."""
    parameters: tuple = ()
    """Rows like those of `actuation.ACTUATION` that it has beside them."""
    replaced: tuple[str, ...] = ()
    """Parameters of a one-way throttle that it does not have."""


ONE_WAY_LAW = LongitudinalLaw()


def law_of(command: LongitudinalCommand) -> LongitudinalLaw:
    """The forces of a kind of command."""
    if command.kind == "throttle_brake_reverse":
        return LongitudinalLaw(two_way_drive, braking_force, BRAKES)
    if command.kind == "current":
        return LongitudinalLaw(commanded_current, replaced=REPLACED)
    if command.kind == "speed":
        drive = two_way_setpoint if command.reverse else controlled_force
        return LongitudinalLaw(drive, None, SPEED_CONTROL, REPLACED)
    return ONE_WAY_LAW
