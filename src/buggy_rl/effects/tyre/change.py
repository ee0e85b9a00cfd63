"""The package's algorithm: axle forces read off a step, and what another friction makes of them."""

from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.effects.motion.base import LOCK, SETTING_OFF, Motion
from buggy_rl.effects.motion.drive import ASKED
from buggy_rl.effects.tyre.law import law, slip_of, slope
from buggy_rl.effects.tyre.spin import DrivenAxles
from buggy_rl.vehicle import GRAVITY, VehicleDimensions

SLOWEST = 0.5  # [m/s] speed below which slip settles no faster; engines soften tyres there too
LEAST_LOAD = 0.05  # [-] least share of the weight on an axle: no car of this height lifts one
ITERATIONS = 2  # of the fixed points for loads and road-wheel angle: each changes a few per cent
HOLDS = 0.98  # [-] share of N D from which the law is faded out, to F' = q F at N D; chosen
SLIP_STIFFNESS = 13.0  # [-] longitudinal force over load and slip ratio at small slip; chosen


@dataclass(frozen=True)
class AxleForces:
    """Forces of the simulated tyres, means of the step, over mass; n rows."""

    side: Tensor
    """[n, 2] side force of front and rear axle [m/s^2]."""
    angle: Tensor
    """[n] road-wheel angle [rad]."""
    couple: Tensor
    """[n] yaw moment of the outer front wheel, which brakes more [m^2/s^2]."""
    drive: Tensor
    """[n] longitudinal force of the driven treads [m/s^2]."""


@dataclass(frozen=True)
class FrictionChange:
    """What another friction changes, of a simulator with these tyres; pairs are front and rear."""

    dimensions: VehicleDimensions
    friction: tuple[float, float]
    """D."""
    stiffness: tuple[float, float]
    """C [1/rad]."""
    shape: tuple[float, float]
    """c."""
    speed_loss: tuple[float, float]
    """b0 and b1 [1/s] of the motor."""
    resistance: tuple[float, float]
    """r0 [m/s^2] and r1 [1/s]."""
    height: float
    """h [m]."""
    driven: DrivenAxles

    def __call__(self, motion: Motion, ratio: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
        """Change [n, 3] of the velocity of the centre of gravity, and z after the step.

        Args:
            motion: The simulator's step; its state is z.
            ratio: Friction over the simulated one, q [n, 2].
            most: Largest lateral acceleration that the tyres give, [n] or () [m/s^2].
        """
        d = self.dimensions
        felt = motion.acceleration
        ax, ay, _ = felt
        share = ax.new_tensor([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
        shape = ax.new_tensor(self.shape)
        resists = self._resistance(motion)
        load = self._load(share, ax + resists)  # (n, 2) over mass
        circle = load * ax.new_tensor(self.friction)  # (n, 2) N D
        seen = self._axle_forces(motion, felt, share, circle[..., 0], resists)
        mean, angle = seen.side, seen.angle
        hold = share * (motion.turn_rate * motion.after[..., 0]).unsqueeze(-1)
        hold = hold - _in_front(self._drive_side(seen.drive, angle))
        lost = (self.speed_loss[0] + self.speed_loss[1] * motion.drive).clamp_min(0.0)
        assert motion.state is not None
        along, left, left_now, spin = self.driven.changed(
            motion.state, seen.drive, lost, circle, ratio, self._slide(motion, angle)
        )
        turned = torch.stack([torch.cos(angle), torch.ones_like(angle)], -1)
        side = turned * circle * left  # (n, 2) what friction leaves for the side force
        side_now = turned * ratio * circle * left_now
        pushed = (along * turned).sum(-1)

        speed = motion.after[..., 0].abs().clamp_min(SLOWEST).unsqueeze(-1)
        rate = motion.dt * ax.new_tensor(self.stiffness) * load / speed  # (n, 2) K dt at s = 0
        slip = slip_of(mean / side, shape)
        start = hold + self._start_of(mean - hold, rate * slope(slip, shape))
        slip = slip_of(start / side, shape)
        stiff, stiff_now = slope(slip, shape), slope(slip / ratio, shape)
        start = hold + self._start_of(mean - hold, rate * stiff)
        use = start / side
        gained = torch.zeros_like(ax)
        for _ in range(ITERATIONS):
            transfer = self._load(share, ax + resists + gained) / load
            scaled = self._scaled(start, use, side, transfer * side_now, ratio)
            bounded = scaled.clamp(-most.unsqueeze(-1) * share, most.unsqueeze(-1) * share)
            mean_now = hold + self._mean_of(bounded - hold, rate * stiff_now)
            gained = pushed - (mean_now - mean)[..., 0] * torch.tan(angle)

        front, rear = (mean_now - mean).unbind(-1)
        front = front + along[..., 0] * torch.sin(angle)
        couple_now = self._couple(ay + front + rear, mean_now[..., 0], angle)
        moment = d.cg_to_front_axle * front - d.cg_to_rear_axle * rear - (couple_now - seen.couple)
        yaw = d.mass / d.yaw_inertia * moment
        return motion.dt * torch.stack([gained, front + rear, yaw], -1), spin

    def _axle_forces(
        self,
        motion: Motion,
        felt: tuple[Tensor, Tensor, Tensor],
        share: Tensor,
        circle: Tensor,
        resists: Tensor,
    ) -> AxleForces:
        """Steps 3 to 5 of the algorithm; `circle` [n] of the front axle."""
        d = self.dimensions
        ax, ay, yaw = felt
        inertia = d.yaw_inertia / d.mass * yaw
        mean = share * ay.unsqueeze(-1)
        angle = couple = drive = torch.zeros_like(ay)
        for _ in range(ITERATIONS):
            moment = (inertia + couple) / d.wheelbase
            mean = share * ay.unsqueeze(-1) + torch.stack([moment, -moment], -1)
            mean = mean - _in_front(self._drive_side(drive, angle))
            angle = self._wheel_angle(motion, mean[..., 0] / circle)
            angle = self._wheel_angle(motion, mean[..., 0] / circle / torch.cos(angle))
            couple = self._couple(ay, mean[..., 0], angle)
            drive = self._drive(motion, mean[..., 0], angle, ax + resists)
        return AxleForces(mean, angle, couple, drive)

    def _drive(self, motion: Motion, front: Tensor, angle: Tensor, pushes: Tensor) -> Tensor:
        """X [n] >= 0 [m/s^2] of both axles together; 0 without a throttle command.

        `pushes` [n] is ax + R.
        """
        forward = 1 - self.driven.front * (1 - torch.cos(angle))
        drive = ((pushes + front * torch.tan(angle)) / forward).clamp_min(0.0)
        return drive * torch.tanh(motion.drive / ASKED)

    def _drive_side(self, drive: Tensor, angle: Tensor) -> Tensor:
        """Side component [n] of a driven front axle's part of the drive [n]."""
        return self.driven.front * drive * torch.sin(angle)

    def _scaled(
        self, start: Tensor, use: Tensor, side: Tensor, side_now: Tensor, ratio: Tensor
    ) -> Tensor:
        """Step 8: forces [n, 2] of the changed axles at the slips of the simulated ones.

        The simulated ones give `start` at these slips, a share `use` of `side`.
        """
        shape = use.new_tensor(self.shape)
        slip = slip_of(use, shape) / ratio
        # A difference of two laws, which is exactly 0 at q = 1; inverse and law cancel to rounding.
        change = side_now * law(slip, shape) - side * law(slip * ratio, shape)
        slides = side_now / side * start
        holds = ((1 - use.abs()) / (1 - HOLDS)).clamp(0.0, 1.0)
        return slides + holds * (start + torch.sign(start) * change - slides)

    def _load(self, share: Tensor, given: Tensor) -> Tensor:
        """N [n, 2] at longitudinal tyre forces [n] [m/s^2]."""
        lift = self.height / self.dimensions.wheelbase * share.new_tensor([-1.0, 1.0])
        return (GRAVITY * share + lift * given.unsqueeze(-1)).clamp_min(LEAST_LOAD * GRAVITY)

    def _couple(self, ay: Tensor, front: Tensor, angle: Tensor) -> Tensor:
        """Yaw moment over mass [n] [m^2/s^2] of the outer front wheel, which brakes more."""
        return self.height / GRAVITY * ay * torch.sin(angle) * front

    def _resistance(self, motion: Motion) -> Tensor:
        """R [n] [m/s^2]."""
        vx = motion.after[..., 0]
        return self.resistance[0] * torch.tanh(vx / SETTING_OFF) + self.resistance[1] * vx

    def _slide(self, motion: Motion, angle: Tensor) -> Tensor:
        """Lateral speed w [n, 2] [m/s] of the contact, no less than by the stretch of the tread."""
        d = self.dimensions
        vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
        front = (vy + d.cg_to_front_axle * yaw_rate) * torch.cos(angle) - vx * torch.sin(angle)
        sideways = torch.stack([front, vy - d.cg_to_rear_axle * yaw_rate], -1)
        friction = vx.new_tensor(self.friction)
        stretch = friction / SLIP_STIFFNESS * vx.abs().clamp_min(SLOWEST).unsqueeze(-1)
        return (sideways.square() + stretch.square()).sqrt()

    def _wheel_angle(self, motion: Motion, use: Tensor) -> Tensor:
        """Step 4: delta [n] [rad] of a front axle that uses a share [n] of its friction."""
        vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
        moves = torch.atan2(vy + self.dimensions.cg_to_front_axle * yaw_rate, vx.clamp_min(SLOWEST))
        c = self.shape[0]
        slip = torch.sign(use) * slip_of(use, use.new_tensor(c))
        return (moves + slip * (c * self.friction[0] / self.stiffness[0])).clamp(-LOCK, LOCK)

    def _mobility(self) -> tuple[float, float, float]:
        """Mass times S: lateral acceleration of an axle by its own force and by the other's."""
        d = self.dimensions
        a, b, i = d.cg_to_front_axle, d.cg_to_rear_axle, d.yaw_inertia / d.mass
        return 1 + a * a / i, 1 - a * b / i, 1 + b * b / i

    def _start_of(self, mean: Tensor, rate: Tensor) -> Tensor:
        """Step 7: (1 + M / 2) of a force [n, 2], from its mean over the step to its start."""
        ff, fr, rr = self._mobility()
        front, rear = mean.unbind(-1)
        slip = torch.stack([ff * front + fr * rear, fr * front + rr * rear], -1)
        return mean + 0.5 * rate * slip

    def _mean_of(self, start: Tensor, rate: Tensor) -> Tensor:
        """Step 9: (1 + M / 2)^-1 of a force [n, 2], by Cramer's rule."""
        ff, fr, rr = self._mobility()
        front, rear = (0.5 * rate).unbind(-1)
        p, q, r, s = 1 + front * ff, front * fr, rear * fr, 1 + rear * rr
        x, y = start.unbind(-1)
        return torch.stack([s * x - q * y, p * y - r * x], -1) / (p * s - q * r).unsqueeze(-1)


def _in_front(force: Tensor) -> Tensor:
    """[n, 2] of front and rear axle: [n] in front, 0 at the rear."""
    return torch.stack([force, torch.zeros_like(force)], -1)
