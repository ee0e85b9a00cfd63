"""Wheels that spin, because they are driven by more than their friction.

A sliding tyre pushes against the way its tread slides: with a tread u faster than the ground that
slides w sideways, F_x / F = u / sqrt(u^2 + w^2) and F_y / F = w / sqrt(u^2 + w^2), w no less than
what it stretches by. So a car that spins its wheels has nothing left for the side.

The simulated u follows from the drive seen; by how much the changed one is larger, z, is a state:
wheels dz/dt = drive - b z - F_x, b what the motor loses with the speed. The reference car on a
floor of grip 0.58 spins its wheels by up to 9 m/s; told its motion, the effect's u is on average
10 to 17 % below the car's where that is above 1 m/s, and up to a half below it under 0.3 m/s.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

WHEELS = 0.085  # what turns with the driven wheels, as a mass at their tread over the car's; chosen
NEWTON = 6  # iterations; of 200 000 drawn cases the worst is 5e-9 m/s off
FULL_CIRCLE = 0.95  # share of the friction circle that a drive can use up; chosen


def spin_of(drive: Tensor, circle: Tensor, across: Tensor) -> Tensor:
    """Spin [*] [m/s] of wheels that give a drive [*], of a friction circle [*].

    Both in m/s^2; `across` [*] [m/s] is w.
    """
    use = drive.clamp_min(1e-6).minimum(FULL_CIRCLE * circle) / circle
    return across * use / (1 - use.square()).sqrt()


def lengthwise(spin: Tensor, circle: Tensor, across: Tensor) -> Tensor:
    """Drive [*] of wheels that spin by [*]: the force points where the tread slides."""
    return circle * spin / (spin.square() + across.square()).sqrt()


def left(spin: Tensor, across: Tensor) -> Tensor:
    """Share [*] of friction circles that is left for the side."""
    return across / (spin.square() + across.square()).sqrt()


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
        before: z before it [*] [m/s].
        pull: Force over mass [*] [m/s^2] that the simulated treads give.
        lost: b [*] [1/s].
        circle: Friction [*] [m/s^2] that the changed ones have.
        across: w [*] [m/s].
        simulated: u of the simulated treads [*] [m/s].
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


@dataclass(frozen=True)
class Driving:
    """The axles that drive, each with wheels that may spin."""

    front: float
    """Share of the drive that the front axle passes, 0..1."""

    @cached_property
    def axles(self) -> slice:
        """Those that drive, of front and rear."""
        return slice(0 if self.front > 0 else 1, 2 if self.front < 1 else 1)

    @cached_property
    def shares(self) -> list[float]:
        """Of the drive, what each of those passes."""
        return [self.front, 1 - self.front][self.axles]

    def driven(
        self,
        before: Tensor,
        drive: Tensor,
        lost: Tensor,
        circle: Tensor,
        ratio: Tensor,
        across: Tensor,
        dt: float,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What drives as another friction lets it.

        Args:
            before: z before the step, of each axle that drives [n, 1] or [n, 2].
            drive: Over mass, seen, of both axles together [n].
            lost: b [n].
            circle: Friction of both axles [n, 2] that the simulated ones have.
            ratio: Of the changed friction to that [n, 2].
            across: w of both axles [n, 2].
            dt: Of the step [s].

        Returns:
            By how much more each axle gives along its treads [n, 2] [m/s^2], the share of its
            friction circle that is left for the side, simulated and changed [n, 2], and z.
        """
        shares, drive = drive.new_tensor(self.shares), drive.unsqueeze(-1)
        # As if each axle passed all of the drive, by its friction over its share of it.
        own, changed = (c[..., self.axles] / shares for c in (circle, ratio * circle))
        across = across[..., self.axles]
        spins = spin_of(drive, own, across)
        pull = lengthwise(spins, own, across)  # the drive, but no more than friction gives
        more = spun(before, pull, lost.unsqueeze(-1), changed, across, spins, dt)
        now = spins + more
        along = torch.zeros_like(circle)
        aside, aside_now = torch.ones_like(circle), torch.ones_like(circle)
        along[..., self.axles] = shares * drive * (lengthwise(now, changed, across) / pull - 1)
        aside[..., self.axles] = left(spins, across)
        aside_now[..., self.axles] = left(now, across)
        return along, aside, aside_now, more
