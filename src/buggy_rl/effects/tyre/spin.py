"""Combined slip of driven wheels: step 6 of the package's algorithm.

A sliding tyre pushes against the direction its tread slides in: with a tread u faster than the
ground that slides w sideways, X / F = u / sqrt(u^2 + w^2) and F_y / F = w / sqrt(u^2 + w^2), w no
less than by the stretch of the tread. So a car that spins its wheels has no side force left.

The simulated u follows from the drive. By how much the changed one is larger, z, is a latent state:
wheels dz/dt = drive - b z - X. Reference car at friction 0.58, spinning by up to 9 m/s: where u is
above 1 m/s the effect's u is 10 to 17 % below the car's on average, below 0.3 m/s up to a half.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

WHEELS = 0.085  # [-] inertia of wheels and motor as a mass at the tread, over the car's; chosen
NEWTON = 6  # iterations; the worst of 200,000 drawn cases is off by 5e-9 m/s
FULL_CIRCLE = 0.95  # [-] largest share of the friction that a drive is taken to use; chosen


def spin_of(drive: Tensor, circle: Tensor, slide: Tensor) -> Tensor:
    """Spin u [*] [m/s] of wheels that give a drive [*] at a friction N D [*], both in m/s^2.

    `slide` [*] [m/s] is w.
    """
    use = drive.clamp_min(1e-6).minimum(FULL_CIRCLE * circle) / circle
    return slide * use / (1 - use.square()).sqrt()


def _drive_of(spin: Tensor, circle: Tensor, slide: Tensor) -> Tensor:
    """Drive [*] [m/s^2] of wheels that spin by u [*]: the inverse of `spin_of`."""
    return circle * spin / (spin.square() + slide.square()).sqrt()


def _left(spin: Tensor, slide: Tensor) -> Tensor:
    """Share [*] of the friction that is left for the side force."""
    return slide / (spin.square() + slide.square()).sqrt()


@dataclass(frozen=True)
class DrivenAxles:
    """The driven axles, each with wheels that may spin."""

    front: Tensor
    """Share of the drive at the front axle, 0..1."""
    dt: Tensor
    """Control period [s]."""
    axles: slice
    """Front and rear axle, those that are driven."""

    @property
    def shares(self) -> Tensor:
        """Share of the drive at each of them, [k, 1] of k driven axles."""
        return torch.stack([self.front, 1 - self.front])[self.axles].unsqueeze(-1)

    def changed(
        self, z: Tensor, drive: Tensor, lost: Tensor, circle: Tensor, ratio: Tensor, slide: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Drive and side friction as another friction makes them.

        Args:
            z: Before the step, of each driven axle [k, n] [m/s].
            drive: X, of both axles together [n] [m/s^2].
            lost: b, decrease of the motor's acceleration with the speed [n] [1/s].
            circle: N D of both simulated axles [2, n] [m/s^2].
            ratio: q of both axles [2, n].
            slide: w of both axles [2, n] [m/s].

        Returns:
            Change of each axle's longitudinal force [2, n] [m/s^2], the share of its friction left
            for the side force, simulated and changed [2, n] each, and z after the step.
        """
        shares = self.shares
        # As if each axle had all of the drive, and its friction over its share of it.
        own, now = (c[self.axles] / shares for c in (circle, ratio * circle))
        slide = slide[self.axles]
        spin = spin_of(drive, own, slide)
        given = _drive_of(spin, own, slide)  # the drive, at most what friction gives
        z = self._next_z(z, (spin, given), lost, now, slide)
        spin_now = spin + z
        along = self._of_both(shares * drive * (_drive_of(spin_now, now, slide) / given - 1), 0.0)
        side, side_now = (self._of_both(_left(s, slide), 1.0) for s in (spin, spin_now))
        return along, side, side_now, z

    def _of_both(self, driven: Tensor, other: float) -> Tensor:
        """[2, n] of front and rear axle, from [k, n] of the driven ones."""
        first, last, _ = self.axles.indices(2)
        rest = torch.full_like(driven[0], other)
        return torch.stack([*[rest] * first, *driven, *[rest] * (2 - last)])

    def _next_z(
        self,
        before: Tensor,
        simulated: tuple[Tensor, Tensor],
        lost: Tensor,
        circle: Tensor,
        slide: Tensor,
    ) -> Tensor:
        """State z [*] after the step, by the implicit Euler method and Newton's method.

        Args:
            before: z [*] [m/s].
            simulated: u [*] [m/s] and drive [*] [m/s^2] of the simulated wheels.
            lost: b [*] [1/s].
            circle: N D [*] [m/s^2] of the changed ones.
            slide: w [*] [m/s].
        """
        spin, drive = simulated
        step = self.dt / WHEELS
        z = before
        for _ in range(NEWTON):
            faster = (spin + z).clamp_min(0.0)
            root = (faster.square() + slide.square()).sqrt()
            residual = z - before - step * (drive - lost * z - circle * faster / root)
            slope = 1 + step * (lost + circle * slide.square() / root**3)
            z = torch.maximum(z - residual / slope, -spin)
        return z
