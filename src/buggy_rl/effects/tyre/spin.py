"""Rear wheels that spin, because they are driven by more than their friction.

A sliding tyre pushes against the way its tread slides: with a tread u faster than the ground that
slides w sideways, F_x / F = u / sqrt(u^2 + w^2) and F_y / F = w / sqrt(u^2 + w^2), w no less than
what it stretches by. So a car that spins its wheels has nothing left for the side.

The simulated u follows from the drive seen; by how much the changed one is larger, z, is a state:
wheels dz/dt = drive - b z - F_x, b what the motor loses with the speed. The reference car on a
floor of grip 0.58 spins its wheels by up to 9 m/s; told its motion, the effect's u is on average
10 to 17 % below the car's where that is above 1 m/s, and up to a half below it under 0.3 m/s.
"""

import torch
from torch import Tensor

WHEELS = 0.085  # what turns with the rear wheels, as a mass at their tread over the car's; chosen
NEWTON = 6  # iterations; of 200 000 drawn cases the worst is 5e-9 m/s off
FULL_CIRCLE = 0.95  # share of the friction circle that a drive can use up; chosen


def spin_of(drive: Tensor, circle: Tensor, across: Tensor) -> Tensor:
    """Spin [n] [m/s] of rear wheels that give a drive [n], of a friction circle [n].

    Both in m/s^2; `across` [n] [m/s] is w.
    """
    use = drive.clamp_min(1e-6).minimum(FULL_CIRCLE * circle) / circle
    return across * use / (1 - use.square()).sqrt()


def lengthwise(spin: Tensor, circle: Tensor, across: Tensor) -> Tensor:
    """Drive [n] of rear wheels that spin by [n]: the force points where the tread slides."""
    return circle * spin / (spin.square() + across.square()).sqrt()


def left(spin: Tensor, across: Tensor) -> Tensor:
    """Share [n, 2] of friction circles that is left for the side: all of it in front."""
    rear = across / (spin.square() + across.square()).sqrt()
    return torch.stack([torch.ones_like(rear), rear], -1)


def spun(
    before: Tensor,
    pull: Tensor,
    lost: Tensor,
    circle: Tensor,
    across: Tensor,
    simulated: Tensor,
    dt: float,
) -> Tensor:
    """How much faster they spin after a step: z, by the implicit Euler rule and Newton's method.

    Args:
        before: z before it [n] [m/s].
        pull: Force over mass [n] [m/s^2] that the simulated treads give.
        lost: b [n] [1/s].
        circle: Friction [n] [m/s^2] that the changed ones have.
        across: w [n] [m/s].
        simulated: u of the simulated treads [n] [m/s].
        dt: Of the step [s].
    """
    step = dt / WHEELS
    z = before
    for _ in range(NEWTON):
        faster = (simulated + z).clamp_min(0.0)
        root = (faster.square() + across.square()).sqrt()
        gap = z - before - step * (pull - lost * z - circle * faster / root)
        slope = 1 + step * (lost + circle * across.square() / root**3)
        z = torch.maximum(z - gap / slope, -simulated)
    return z
