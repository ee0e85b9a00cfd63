"""The road-wheel angle of a simulated car, and what its tyres leave of a side force on an axle."""

from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.effects.motion.base import LOCK, Motion
from buggy_rl.effects.tyre.law import slip_of

SLOWEST = 0.3  # [m/s] speed below which angles and the settling of slip are those at it; chosen


@dataclass(frozen=True)
class FrontAxle:
    """What turns a side force of the front axle into a slip angle."""

    stiffness: float = 0.0
    """C, side force over load and slip angle [1/rad]; 0 for a simulator without tyres."""
    friction: float = 0.84
    """D, largest side force over load."""
    shape: float = 1.2
    """c, shape factor of the magic formula."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""


def steered_angle(motion: Motion, dimensions: VehicleDimensions, axle: FrontAxle) -> Tensor:
    """Direction in which the front axle moves, plus the slip angle that gives its side force.

    delta = atan2(vy + a r, |vx|) + (c D / C) tan(asin(F_f / (D N_f)) / c), negative in reverse,
    where wheels that are turned to the left point to the right of where they roll. F_f =
    (b ay + (I / m) dr/dt) / L is over mass, as the load N_f = g b / L. The less a car moves below
    0.3 m/s, the less its motion tells, and the more the command does: lock times steering.

    Source: Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 1.3 and 4.3.

    Args:
        motion: Of n environments.
        dimensions: Of the car.
        axle: Its front axle.

    Returns:
        [n] rad.
    """
    d = dimensions
    vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
    angle = torch.atan((vy + d.cg_to_front_axle * yaw_rate) / vx.abs().clamp_min(SLOWEST))
    if axle.stiffness > 0:
        _, ay, turning = motion.acceleration
        front = d.cg_to_rear_axle * ay + d.yaw_inertia / d.mass * turning  # times L
        use = front / (axle.friction * GRAVITY * d.cg_to_rear_axle)
        slip = torch.sign(use) * slip_of(use, torch.as_tensor(axle.shape).to(use))
        angle = angle + axle.shape * axle.friction / axle.stiffness * slip
    standing = (1 - vx.abs() / SLOWEST).clamp_min(0.0)
    angle = torch.where(vx < 0, -angle, angle) + standing * axle.lock * motion.action[..., 1]
    return angle.clamp(-axle.lock, axle.lock)


def left_by_tyres(
    motion: Motion,
    dimensions: VehicleDimensions,
    stiffness: tuple[float, float],
    front: Tensor,
    rear: Tensor,
) -> tuple[Tensor, Tensor]:
    """What remains of side forces on the axles, once the tyres have answered within the step.

    Args:
        motion: Of n environments.
        dimensions: Of the car.
        stiffness: C of front and rear axle, over load [1/rad]; 0: no tyres.
        front: [n] over mass [m/s^2].
        rear: [n] likewise.

    Returns:
        Both [n].
    """
    d, vx = dimensions, motion.after[..., 0]
    a, b, i = d.cg_to_front_axle, d.cg_to_rear_axle, d.yaw_inertia / d.mass
    rate = 0.5 * motion.dt * GRAVITY / vx.abs().clamp_min(SLOWEST) / d.wheelbase
    f, r = rate * stiffness[0] * b, rate * stiffness[1] * a
    p, q = 1 + f * (1 + a * a / i), f * (1 - a * b / i)
    s, t = 1 + r * (1 + b * b / i), r * (1 - a * b / i)
    determinant = p * s - q * t
    return (s * front - q * rear) / determinant, (p * rear - t * front) / determinant
