"""Forces along a bicycle: motor, brakes, speed and current controllers, resistance.

`speed` is that of the driven wheels [m/s], `drive` the command in -1..1 or 0..1, `values` the
parameters. Laws of commands with brakes and reverse hold for tensors and NumPy arrays alike.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.simulators.bicycle.parameters import BRAKES, REPLACED, SPEED_CONTROL

LEFT_RIGHT_BLEND = 30.0  # [-] steepness of the blend from right to left; dart_dynamic_models.py
ROLLS = 0.2  # [m/s] forward speed above which a two-way ESC brakes; fades into reverse; chosen
IDLE = 0.05  # [-] drive beyond the dead zone at which the drag brake is off; chosen
STEERING_DRAG_ONSET = 0.3  # [m/s] speed at which steering drag begins; dart_dynamic_models.py
STEERING_DRAG_STEEPNESS = 20.0  # [s/m] of that onset; dart_dynamic_models.py

DriveForce = Callable[[Tensor, Tensor, Mapping[str, Tensor]], Tensor]
"""Force [*] N at a speed [*] m/s and a drive [*], by parameter values."""


def rolling_forward(vx: Any) -> Any:
    """Share 0..1 of a brake, and not of reverse, in a command below 0: min(max(vx / v0, 0), 1)."""
    return (vx / ROLLS).clip(0.0, 1.0)


def esc_drive(speed: Any, rolls: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] of the motor behind a two-way ESC.

    F = (f0 - f1 v) max(0, d - z) - q max(0, f0 + f1 v) max(0, -d - z_r) (1 - rolls).

    `rolls` is `rolling_forward` of the car: that it has to stand before it reverses.
    """
    forward = (drive - values["throttle_deadband"]).clip(0.0)
    backward = (-drive - values["reverse_deadband"]).clip(0.0) * values["reverse_share"]
    lost = values["drive_force_loss"] * speed
    pulls = (values["drive_force"] - lost) * forward
    return pulls - (values["drive_force"] + lost).clip(0.0) * backward * (1 - rolls)


def esc_brakes(drive: Any, values: Mapping[str, Any]) -> tuple[Any, Any]:
    """Forces [N] >= 0 of the brake by the command, and of the drag brake without one."""
    forward = (drive - values["throttle_deadband"]).clip(0.0)
    backward = (-drive - values["reverse_deadband"]).clip(0.0)
    idle = (1 - (forward + backward) / IDLE).clip(0.0)
    return values["brake_force"] * backward, values["drag_brake"] * idle


def braking_force(vx: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] of the brakes on a car at vx [m/s]: against the motion, 0 at rest."""
    pressed, dragging = esc_brakes(drive, values)
    return -(pressed * rolling_forward(vx) + dragging * (vx / ROLLS).clip(-1.0, 1.0))


def setpoint_force(speed: Any, rolls: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] behind a proportional controller whose setpoint v_full d may be negative.

    F = k (v_full d - v), in the direction of the motion at most f0 - f1 |v|, against it at most the
    brake force; `rolls` plays no part.
    """
    del rolls
    wanted = values["speed_gain"] * (values["full_speed"] * drive - speed)
    return _limited(wanted, speed, values, values["brake_force"])


def current_force(speed: Any, rolls: Any, drive: Any, values: Mapping[str, Any]) -> Any:
    """Force [N] of a motor whose current is commanded: F = f0 d, of either sign.

    In the direction of the motion back-EMF leaves at most f0 - f1 |v|; `rolls` plays no part.
    """
    del rolls
    return _limited(values["drive_force"] * drive, speed, values, values["drive_force"])


def _limited(force: Any, speed: Any, values: Mapping[str, Any], against: Any) -> Any:
    """A force within what the motor has along its motion, and `against` it; continuous at rest."""
    ahead = (0.5 + 0.5 * speed / ROLLS).clip(0.0, 1.0)
    lost = values["drive_force_loss"] * speed
    forward = (values["drive_force"] - lost).clip(0.0)
    backward = (values["drive_force"] + lost).clip(0.0)
    most = ahead * forward + (1 - ahead) * against
    least = ahead * against + (1 - ahead) * backward
    return force.clip(-least, most)


def controlled_force(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of a motor behind a proportional speed controller, drive in 0..1.

    F = max(min(k (v_full drive - vx), f0 - f1 vx), -F_brake): what the motor and its brake can.
    The setpoint is not negative, so only a car above it is braked; `setpoint_force` has one
    that may be.
    """
    wanted = values["speed_gain"] * (values["full_speed"] * drive - vx)
    available = (values["drive_force"] - values["drive_force_loss"] * vx).clamp_min(0.0)
    return torch.maximum(torch.minimum(wanted, available), -values["brake_force"])


def steady_drive(vx: Tensor, needed: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Drive [*] in 0..1 that holds a speed [*] against a resistance [*] N; not clamped."""
    return (vx + needed / values["speed_gain"]) / values["full_speed"]


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
    """Force [*] N of the motor behind a two-way ESC; see `esc_drive`."""
    return esc_drive(vx, rolling_forward(vx), drive, values)


def two_way_setpoint(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of a speed controller with reverse; see `setpoint_force`."""
    return setpoint_force(vx, None, drive, values)


def commanded_current(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of a commanded current; see `current_force`."""
    return current_force(vx, None, drive, values)


@dataclass(frozen=True)
class LongitudinalLaw:
    """Motor and brakes of one kind of command."""

    drive: DriveForce = motor_force
    """Force of the motor, shared between the axles as the drive is."""
    brake: DriveForce | None = None
    """Force of brakes with a share of their own; None where the motor's force is all there is."""
    parameters: tuple = ()
    """Rows like those of `parameters.ACTUATION` that it has beside them."""
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
