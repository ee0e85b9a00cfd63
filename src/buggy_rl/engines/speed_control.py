"""A speed controller in the place of the throttle: the command is a setpoint, not a drive."""

from collections.abc import Mapping

import torch
from torch import Tensor

# name, lower, upper, unit, meaning; ranges and the values in `SHIPPED` are those of the buggy
SPEED_CONTROL = (
    ("full_speed", 0.5, 30.0, "m/s", "Speed setpoint of a full command."),
    ("speed_gain", 0.5, 200.0, "N s/m", "Force of the controller for each m/s that is missing."),
    ("brake_force", 0.0, 50.0, "N", "Largest force of the controller against the motion."),
)
SHIPPED = {
    "full_speed": 5.0,  # [m/s] chosen; a car's file states its own
    "speed_gain": 16.0,  # [N s/m] of 1.6 kg: a time constant of 0.1 s; chosen
    "brake_force": 8.0,  # [N] 0.5 g of 1.6 kg; chosen
}
REPLACED = ("throttle_deadband",)  # parameters of a throttle that a setpoint does not have


def controlled_force(vx: Tensor, drive: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Force [*] N of a motor behind a proportional speed controller, drive in 0..1.

    F = max(min(k (v_full drive - vx), f0 - f1 vx), -F_brake): what the motor and its brake can.
    The setpoint is not negative, so only a car above it is braked; `two_way.setpoint_force` has one
    that may be.
    """
    wanted = values["speed_gain"] * (values["full_speed"] * drive - vx)
    available = (values["drive_force"] - values["drive_force_loss"] * vx).clamp_min(0.0)
    return torch.maximum(torch.minimum(wanted, available), -values["brake_force"])


def steady_drive(vx: Tensor, needed: Tensor, values: Mapping[str, Tensor]) -> Tensor:
    """Drive [*] in 0..1 that holds a speed [*] against a resistance [*] N; not clamped."""
    return (vx + needed / values["speed_gain"]) / values["full_speed"]
