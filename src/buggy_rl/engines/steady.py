"""The actuators of a car in motion at a reset, by the steady drive that it is taken to have."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.engines.longitudinal_force import resistance
from buggy_rl.engines.speed_control import steady_drive
from buggy_rl.engines.steering_map import steering_command
from buggy_rl.longitudinal import LongitudinalCommand, command_of
from buggy_rl.vehicle import shift_velocity

SLOWEST_ARC = 0.5  # [m/s] speed below which no arc follows from a yaw rate; chosen
LEAST_FORCE = 1e-3  # [N] least force of a motor that a drive is divided by


def steady_actuators(
    command: LongitudinalCommand, values: Mapping[str, Tensor], velocity: Tensor
) -> Tensor:
    """Throttle and steering [*, 2] with which a car keeps a velocity [*, 3] of its sensor.

    The motor balances the resistance, the road wheels follow the arc. A standing car has no drive;
    one that rolls back has none either unless its command has reverse.
    """
    v = values
    vx, _, yaw_rate = shift_velocity(velocity, -v["sensor_x"], -v["sensor_y"]).unbind(-1)
    wheelbase = v["cg_to_front_axle"] + v["cg_to_rear_axle"]
    backward = vx < 0 if command.two_way else torch.zeros_like(vx, dtype=torch.bool)
    # A car in reverse is that of its mirrored motion: forward at -vx, with the yaw rate reversed.
    ahead = torch.where(backward, -vx, vx)
    turns = torch.where(backward, -yaw_rate, yaw_rate)
    angle = torch.atan(wheelbase * turns / ahead.clamp_min(SLOWEST_ARC))
    needed = resistance(ahead, angle, v)
    drive = _drive(command, v, ahead, needed, backward) * (ahead > 0)
    drive = torch.where(backward, -drive.clamp(0.0, 1.0), drive.clamp(0.0, 1.0))
    return torch.stack([command_of(drive, command.rest), steering_command(angle, v)], -1)


def _drive(
    command: LongitudinalCommand,
    v: Mapping[str, Tensor],
    ahead: Tensor,
    needed: Tensor,
    backward: Tensor,
) -> Tensor:
    """Size of the drive [*] that balances a resistance [*] N at a speed [*] m/s; not clamped."""
    if command.kind == "speed":
        return steady_drive(ahead, needed, v)
    if command.kind == "current":
        return needed / v["drive_force"].clamp_min(LEAST_FORCE)
    available = (v["drive_force"] - v["drive_force_loss"] * ahead).clamp_min(LEAST_FORCE)
    forward = v["throttle_deadband"] + needed / available
    if not command.two_way:
        return forward
    reverse = (available * v["reverse_share"]).clamp_min(LEAST_FORCE)
    return torch.where(backward, v["reverse_deadband"] + needed / reverse, forward)
