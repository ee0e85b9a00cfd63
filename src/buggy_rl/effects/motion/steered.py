"""The road-wheel angle of the simulated front axle, read off a step of its motion."""

import torch
from torch import Tensor

from buggy_rl.effects.motion.base import Motion
from buggy_rl.vehicle import GRAVITY, VehicleDimensions

SLOWEST = 0.3  # [m/s] speed below which the angle is read off as at it, so smaller; chosen


def road_wheel_angle(
    motion: Motion, dimensions: VehicleDimensions, stiffness: float, lock: float
) -> Tensor:
    """Where the front axle moves, plus the slip angle that gives its side force.

    delta = atan2(vy + a r, |vx|) + F_f / (C N_f), negative in reverse, where wheels that are turned
    to the left point to the right of where they roll. F_f = (b ay + (I / m) dr/dt) / L is over
    mass, as the load N_f = g b / L.

    Source: Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., sec. 2.3 (single-track car).

    Args:
        motion: Of n environments.
        dimensions: Of the car.
        stiffness: C of the front axle, side force over load and slip angle [1/rad]; 0: no tyres.
        lock: Largest angle [rad].

    Returns:
        [n] rad.
    """
    d = dimensions
    vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
    angle = torch.atan2(vy + d.cg_to_front_axle * yaw_rate, vx.abs().clamp_min(SLOWEST))
    if stiffness > 0:
        _, ay, turning = motion.acceleration
        front = (d.cg_to_rear_axle * ay + d.yaw_inertia / d.mass * turning) / d.wheelbase
        angle = angle + front * d.wheelbase / (stiffness * GRAVITY * d.cg_to_rear_axle)
    return torch.where(vx < 0, -angle, angle).clamp(-lock, lock)
