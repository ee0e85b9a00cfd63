"""The package's algorithm: axle forces read off a step, and what another friction makes of them.

Pairs of front and rear axle are the first dimension, [2, n]: the batch is then contiguous, which is
what a compiler turns into vector instructions.
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import Any, ClassVar, Self

import torch
from torch import Tensor

from buggy_rl.core.kernels import Kernel
from buggy_rl.core.vehicle import GRAVITY, side_by_side_columns
from buggy_rl.effects.motion.base import SETTING_OFF, Motion
from buggy_rl.effects.motion.drive import ASKED
from buggy_rl.effects.tyre.law import law, slip_of, slope
from buggy_rl.effects.tyre.spin import DrivenAxles

SLOWEST = 0.5  # [m/s] speed below which slip settles no faster; engines soften tyres there too
LEAST_LOAD = 0.05  # [-] least share of the weight on an axle: no car of this height lifts one
ITERATIONS = 2  # of the fixed points for loads and road-wheel angle: each changes a few per cent
HOLDS = 0.98  # [-] share of N D from which the law is faded out, to F' = q F at N D; chosen
SLIP_STIFFNESS = 13.0  # [-] longitudinal force over load and slip ratio at small slip; chosen


@dataclass(frozen=True)
class AxleForces:
    """Forces of the simulated tyres, means of the step, over mass; n rows."""

    side: Tensor
    """[2, n] side force of front and rear axle [m/s^2]."""
    angle: Tensor
    """[n] road-wheel angle [rad]."""
    couple: Tensor
    """[n] yaw moment of the outer front wheel, which brakes more [m^2/s^2]."""
    drive: Tensor
    """[n] longitudinal force of the driven treads [m/s^2]."""


@dataclass(frozen=True)
class FrictionChange:
    """What another friction changes, of a simulator with these tyres; its numbers are tensors."""

    kernel: ClassVar[str] = "friction_change"
    """Begins the names of its compiled packages."""
    rows: ClassVar[int] = 2
    """Numbers of an environment that say what is changed."""

    front_arm: Tensor
    """a [m]."""
    rear_arm: Tensor
    """b [m]."""
    mass: Tensor
    """m [kg]."""
    yaw_inertia: Tensor
    """I [kg m^2]."""
    friction: Tensor
    """D [2, 1]."""
    stiffness: Tensor
    """C [2, 1] [1/rad]."""
    shape: Tensor
    """c [2, 1]."""
    speed_loss: Tensor
    """b0 and b1 [2] [1/s] of the motor."""
    resistance: Tensor
    """r0 [m/s^2] and r1 [1/s], [2]."""
    height: Tensor
    """h [m]."""
    combined: Tensor
    """1 where the drive takes from the side force by the friction ellipse, 0 where it does not."""
    lock: Tensor
    """Largest road-wheel angle [rad]."""
    driven: DrivenAxles
    two_way: bool = False
    """Whether the car may drive backward: then its front wheels point against where they roll."""

    @classmethod
    def of(cls, numbers: Tensor, axles: slice, two_way: bool = False) -> Self:
        """Makes a change from all the numbers side by side [19] and the axles that are driven."""
        front_arm, rear_arm, mass, yaw_inertia = numbers[:4].unbind()
        friction, stiffness, shape = numbers[4:10].view(3, 2, 1).unbind()
        speed_loss, resistance = numbers[10:14].view(2, 2).unbind()
        height, front, combined, lock, dt = numbers[14:].unbind()
        return cls(
            front_arm=front_arm,
            rear_arm=rear_arm,
            mass=mass,
            yaw_inertia=yaw_inertia,
            friction=friction,
            stiffness=stiffness,
            shape=shape,
            speed_loss=speed_loss,
            resistance=resistance,
            height=height,
            combined=combined,
            lock=lock,
            driven=DrivenAxles(front, dt, axles),
            two_way=two_way,
        )

    @property
    def share(self) -> Tensor:
        """Shares of the weight, [2, 1]: b / L and a / L."""
        return torch.stack([self.rear_arm, self.front_arm]).unsqueeze(-1) / self.wheelbase

    @property
    def wheelbase(self) -> Tensor:
        """L [m]."""
        return self.front_arm + self.rear_arm

    def __call__(self, motion: Motion, ratio: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
        """Change [n, 3] of the velocity of the centre of gravity, and z after the step.

        Args:
            motion: The simulator's step; its state is z.
            ratio: Friction over the simulated one, q [2, n]; of a subclass what it changes [k, n].
            most: Largest lateral acceleration that the tyres give, [n] or () [m/s^2].
        """
        felt = motion.acceleration
        ax, ay, _ = felt
        share = self.share
        resists = self._resistance(motion)
        load = self._load(ax + resists)  # (2, n) over mass
        circle = load * self.friction  # (2, n) N D
        seen = self._axle_forces(motion, felt, circle[0], resists)
        mean, angle = seen.side, seen.angle
        hold = share * (motion.turn_rate * motion.after[..., 0])
        hold = hold - _in_front(self._drive_side(seen.drive, angle))
        lost = (self.speed_loss[0] + self.speed_loss[1] * motion.drive).clamp_min(0.0)
        assert motion.state is not None
        grip = self._grip(ratio)  # (2, n)
        along, left, left_now, spin = self.driven.changed(
            motion.state.movedim(-1, 0),
            self.combined * seen.drive,
            lost,
            circle,
            grip,
            self._slide(motion, angle),
        )
        turned = torch.stack([torch.cos(angle), torch.ones_like(angle)])
        side = turned * circle * left  # (2, n) what friction leaves for the side force
        side_now = turned * grip * circle * left_now
        pushed = (along * turned).sum(0)

        speed = motion.after[..., 0].abs().clamp_min(SLOWEST)
        rate = self.driven.dt * self.stiffness * load / speed  # (2, n) K dt at s = 0
        slip = slip_of(mean / side, self.shape)
        start = hold + self._start_of(mean - hold, rate * slope(slip, self.shape))
        slip = torch.sign(start) * slip_of(start / side, self.shape)
        _, stiff_now = self._slip_now(slip, ratio, load)
        start = hold + self._start_of(mean - hold, rate * slope(slip, self.shape))
        use = start / side
        slip = torch.sign(start) * slip_of(use, self.shape)
        slips = slip, self._slip_now(slip, ratio, load)[0]
        gained, mean_now = torch.zeros_like(ax), mean
        for _ in range(ITERATIONS):
            transfer = self._load(ax + resists + gained) / load
            scaled = self._scaled(start, use, side, transfer * side_now, slips)
            bounded = scaled.clamp(-most * share, most * share)
            mean_now = hold + self._mean_of(bounded - hold, rate * stiff_now)
            gained = pushed - (mean_now - mean)[0] * torch.tan(angle)

        front, rear = (mean_now - mean).unbind()
        front = front + along[0] * torch.sin(angle)
        couple_now = self._couple(ay + front + rear, mean_now[0], angle)
        moment = self.front_arm * front - self.rear_arm * rear - (couple_now - seen.couple)
        yaw = self.mass / self.yaw_inertia * moment
        dt = self.driven.dt
        return side_by_side_columns(dt * gained, dt * (front + rear), dt * yaw), spin.movedim(0, -1)

    def _axle_forces(
        self,
        motion: Motion,
        felt: tuple[Tensor, Tensor, Tensor],
        circle: Tensor,
        resists: Tensor,
    ) -> AxleForces:
        """Steps 3 to 5 of the algorithm; `circle` [n] of the front axle."""
        ax, ay, yaw = felt
        inertia = self.yaw_inertia / self.mass * yaw
        mean = self.share * ay
        angle = couple = drive = torch.zeros_like(ay)
        for _ in range(ITERATIONS):
            moment = (inertia + couple) / self.wheelbase
            mean = self.share * ay + torch.stack([moment, -moment])
            mean = mean - _in_front(self._drive_side(drive, angle))
            angle = self._wheel_angle(motion, mean[0] / circle)
            angle = self._wheel_angle(motion, mean[0] / circle / torch.cos(angle))
            couple = self._couple(ay, mean[0], angle)
            drive = self._drive(motion, mean[0], angle, ax + resists)
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

    def _grip(self, ratio: Tensor) -> Tensor:
        """Friction over the simulated one [2, n]."""
        return ratio

    def _slip_now(self, slip: Tensor, ratio: Tensor, load: Tensor) -> tuple[Tensor, Tensor]:
        """Slip s [2, n] of the changed axles at one of the simulated ones, signed as its force.

        And the slope of the changed law over that at s = 0. `load` [2, n] is over mass.
        """
        del load
        return slip / ratio, slope(slip / ratio, self.shape)

    def _scaled(
        self,
        start: Tensor,
        use: Tensor,
        side: Tensor,
        side_now: Tensor,
        slips: tuple[Tensor, Tensor],
    ) -> Tensor:
        """Step 8: forces [2, n] of the changed axles, at slips of the simulated ones and of them.

        The simulated ones give `start` at these slips, a share `use` of `side`.
        """
        # A difference of two laws, which is exactly 0 at q = 1; inverse and law cancel to rounding.
        change = side_now * law(slips[1], self.shape) - side * law(slips[0], self.shape)
        slides = side_now / side * start
        holds = ((1 - use.abs()) / (1 - HOLDS)).clamp(0.0, 1.0)
        return slides + holds * (start + change - slides)

    def _load(self, given: Tensor) -> Tensor:
        """N [2, n] at longitudinal tyre forces [n] [m/s^2]."""
        lift = self.height / self.wheelbase * given
        return (GRAVITY * self.share + torch.stack([-lift, lift])).clamp_min(LEAST_LOAD * GRAVITY)

    def _couple(self, ay: Tensor, front: Tensor, angle: Tensor) -> Tensor:
        """Yaw moment over mass [n] [m^2/s^2] of the outer front wheel, which brakes more."""
        return self.height / GRAVITY * ay * torch.sin(angle) * front

    def _resistance(self, motion: Motion) -> Tensor:
        """R [n] [m/s^2]."""
        vx = motion.after[..., 0]
        return self.resistance[0] * torch.tanh(vx / SETTING_OFF) + self.resistance[1] * vx

    def _slide(self, motion: Motion, angle: Tensor) -> Tensor:
        """Lateral speed w [2, n] [m/s] of the contact, no less than by the stretch of the tread."""
        vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
        front = (vy + self.front_arm * yaw_rate) * torch.cos(angle) - vx * torch.sin(angle)
        sideways = torch.stack([front, vy - self.rear_arm * yaw_rate])
        stretch = self.friction / SLIP_STIFFNESS * vx.abs().clamp_min(SLOWEST)
        return (sideways.square() + stretch.square()).sqrt()

    def _wheel_angle(self, motion: Motion, use: Tensor) -> Tensor:
        """Step 4: delta [n] [rad] of a front axle that uses a share [n] of its friction."""
        vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
        ahead = vx.abs() if self.two_way else vx
        # Not atan2: its vector instructions round otherwise than its tail of a batch, so that rows
        # would depend on how many there are.
        moves = torch.atan((vy + self.front_arm * yaw_rate) / ahead.clamp_min(SLOWEST))
        c = self.shape[0]  # (1,)
        slip = torch.sign(use) * slip_of(use, c)
        angle = (moves + slip * (c * self.friction[0] / self.stiffness[0])).clamp(
            -self.lock, self.lock
        )
        return torch.where(vx < 0, -angle, angle) if self.two_way else angle

    def _mobility(self) -> tuple[Tensor, Tensor, Tensor]:
        """Mass times S: lateral acceleration of an axle by its own force and by the other's."""
        a, b, i = self.front_arm, self.rear_arm, self.yaw_inertia / self.mass
        return 1 + a * a / i, 1 - a * b / i, 1 + b * b / i

    def _start_of(self, mean: Tensor, rate: Tensor) -> Tensor:
        """Step 7: (1 + M / 2) of a force [2, n], from its mean over the step to its start."""
        ff, fr, rr = self._mobility()
        front, rear = mean.unbind()
        slip = torch.stack([ff * front + fr * rear, fr * front + rr * rear])
        return mean + 0.5 * rate * slip

    def _mean_of(self, start: Tensor, rate: Tensor) -> Tensor:
        """Step 9: (1 + M / 2)^-1 of a force [2, n], by Cramer's rule."""
        ff, fr, rr = self._mobility()
        front, rear = (0.5 * rate).unbind()
        p, q, r, s = 1 + front * ff, front * fr, rear * fr, 1 + rear * rr
        x, y = start.unbind()
        return torch.stack([s * x - q * y, p * y - r * x]) / (p * s - q * r)


def _in_front(force: Tensor) -> Tensor:
    """[2, n] of front and rear axle: [n] in front, 0 at the rear."""
    return torch.stack([force, torch.zeros_like(force)])


def _changed(
    kind: type[FrictionChange], axles: slice, two_way: bool, *arguments: Tensor
) -> tuple[Tensor, Tensor]:
    numbers, before, after, action, state, ratio, most = arguments
    dt: Any = numbers[-1]
    pose = before  # the change does not depend on it
    motion = Motion(pose, before, after, action, dt, state)
    return kind.of(numbers, axles, two_way)(motion, ratio, most)


def _example(kind: type[FrictionChange], axles: slice, n: int) -> tuple[Tensor, ...]:
    numbers = torch.tensor([0.08, 0.07, 2.0, 0.01, *[1.0] * 10, 0.03, 0.5, 1.0, 0.45, 0.01])
    before = torch.tensor([1.0, 0.01, 0.1])[:, None].repeat(1, n).T
    ones, state = torch.ones(n, 2), torch.zeros(n, len(range(2)[axles]))
    ratio, most = torch.full((kind.rows, n), 0.8), torch.full((n,), 9.0)
    return numbers, before, before.clone(), 0.2 * ones, state, ratio, most


def driven_axles(front_share: float) -> tuple[int, int]:
    """Driven axles, first to before last, of a car with a share of its drive in front."""
    return (0 if front_share > 0 else 1, 2 if front_share < 1 else 1)


@cache
def changed_by(
    axles: tuple[int, int], two_way: bool = False, kind: type[FrictionChange] = FrictionChange
) -> Kernel:
    """`FrictionChange`, or a subclass, of a car with these driven axles, first to before last.

    Its arguments: numbers [19], velocity before and after the step [n, 3], command [n, 2], z
    [n, 1 or 2], ratio [k, n], largest lateral acceleration [n].
    """
    of = slice(*axles)
    return Kernel(
        f"{kind.kernel}_{axles[0]}{axles[1]}" + ("_two_way" if two_way else ""),
        partial(_changed, kind, of, two_way),
        partial(_example, kind, of),
        (None, 0, 0, 0, 0, 1, 0),
    )


REAR_DRIVEN = changed_by((1, 2))
ALL_DRIVEN = changed_by((0, 2))
FRONT_DRIVEN = changed_by((0, 1))
REAR_DRIVEN_TWO_WAY = changed_by((1, 2), two_way=True)
ALL_DRIVEN_TWO_WAY = changed_by((0, 2), two_way=True)
FRONT_DRIVEN_TWO_WAY = changed_by((0, 1), two_way=True)
