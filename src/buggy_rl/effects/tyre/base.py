"""Tyres that hold less than the simulated ones, around a simulator whose tyres cannot be seen.

From what the engine did in a step follow the accelerations, and from those what each axle gave
sideways, per mass of the car [m/s^2], with the axles a ahead of and b behind the centre of gravity:

    F_front = (ay b + I/m dr/dt) / L,   F_rear = (ay a - I/m dr/dt) / L.

These are changed and put back. Six things matter.

- *Friction is a bound, not a factor.* On a slippery floor a tyre is as stiff as ever and slides
  earlier: F'(slip) = g F(slip / g). With F = D sin(c atan(s)), s = C slip / (c D), the slip is read
  off the force, s = tan(asin(F / D) / c), and F' = g D sin(c atan(s / g)): F as long as the tyre
  holds, g F where it slides. A tyre that slides gives the same at any slip, so past `HOLDS` of D
  the slip is no longer read off the force, and F' becomes g F.
- *Within a step forces relax.* At 2 m/s the slip of this car settles in about one period, so what
  is seen is a mean over the settling, not what the tyre gives at the slip the step began with. With
  the slip's rate d(slip)/dt = S (F - F_hold), S the mobility of the axles, F_hold what keeps the
  turn as it is, the mean is F_hold + (1 + X / 2)^-1 (F_start - F_hold), X = dt S K, K the slope of
  the tyre law. It is undone with the engine's slope and done again with the changed one.
- *Front wheels push square to where they point*, so a part of their force brakes.
- *The rear axle also drives, and spins* where that is more than its friction (`spin`). By how much
  faster than the simulated it spins is a state of the effect. Where the front axle passes a share
  of the drive, it pulls to where its wheels point, and spins likewise.
- *It drives against what resists at the body* as well, such as the air: a drive that is not seen
  in the acceleration. What resists inside of motor and gear loads no tyre.
- *The car leans* by what its tyres give lengthwise: h F_x / (L g) of the weight goes to the rear
  axle. In a bend its turned front wheels lean it forward; but the outer one, which carries more,
  then also brakes more, a yaw moment h F_front sin(angle) ay / g whatever the track, and that
  undoes most of what the front axle gains. Leaning without that moment was worse than neither.

The engine's own tyres D, C, c, its resistance and its height h are assumed; `measuring.tyres` finds
them for a simulator.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from buggy_rl.effects.motion.base import LOCK, SETTING_OFF, Motion, MotionEffect
from buggy_rl.effects.motion.drive import ASKED, SPEED_LOSS
from buggy_rl.effects.tyre.law import law, slip_of, slope
from buggy_rl.effects.tyre.spin import Driving
from buggy_rl.vehicle import GRAVITY

Axles = float | Sequence[float]

FRICTION = 0.84  # D over load, DART's 0.84 front and 0.85 rear
STIFFNESS = (6.1, 9.4)  # [1/rad] C over load, front and rear: DART's B C D
SHAPE = (1.2, 1.2)  # c, between a tyre that bends over slowly (1) and a brush (1.4); chosen
RESISTANCE = (0.0, 0.0)  # [m/s^2], [1/s]: all of it inside of motor and gear
HEIGHT = 0.0  # [m] of a simulator that does not lean
FRONT_DRIVE_SHARE = 0.0  # the buggy's rear axle drives it
SLOWEST = 0.5  # [m/s] below it slip settles no faster; engines, too, soften tyres at a crawl
LEAST_LOAD = 0.05  # of the weight, on an axle; no car of this height lifts one
LEANING = 2  # passes: forces lean the car, and leaning changes forces by a few per cent
HOLDS = 0.98  # of D, from where on a tyre begins to slide; at D it does; chosen
LENGTHWISE = 13.0  # [-] longitudinal force over load and slip, at small slip; chosen


class TyreEffect(MotionEffect):
    """Axle forces as another friction would have made them.

    Args:
        friction: Largest tyre force over load that the engine has: one number, or front and rear.
        stiffness: Its lateral force over load and slip angle, at small slip [1/rad]; likewise.
        shape: c of its law, likewise.
        speed_loss: b0 and b1 [1/s] of what its motor loses with the speed, b = b0 + b1 drive.
        resistance: r0 [m/s^2] and r1 [1/s] of what resists at its body, r0 + r1 vx.
        height: At which it leans [m].
        front_drive_share: Share of its drive that the front axle passes, 0..1.
        dimensions, dt, values: As for the other motion effects.

    Raises:
        ValueError: A tyre's number is not above 0, or a share not within 0..1.
    """

    def __init__(
        self,
        *,
        friction: Axles = FRICTION,
        stiffness: Axles = STIFFNESS,
        shape: Axles = SHAPE,
        speed_loss: Sequence[float] = SPEED_LOSS,
        resistance: Sequence[float] = RESISTANCE,
        height: float = HEIGHT,
        front_drive_share: float = FRONT_DRIVE_SHARE,
        **rest: Any,
    ) -> None:
        if not 0.0 <= front_drive_share <= 1.0:
            raise ValueError(
                f"effect {self.name!r}: front_drive_share is {front_drive_share}: must be within "
                "0 (the rear axle drives) and 1 (the front one does)"
            )
        self._driving = Driving(float(front_drive_share))
        self.carries = len(self._driving.shares)
        self.speed_loss = (float(speed_loss[0]), float(speed_loss[1]))
        self.resistance = (float(resistance[0]), float(resistance[1]))
        self.height = float(height)
        self.friction = self._both("friction", friction)
        self.stiffness = self._both("stiffness", stiffness)
        self.shape = self._both("shape", shape)
        super().__init__(**rest)

    def _both(self, what: str, value: Axles) -> tuple[float, float]:
        front, rear = value if isinstance(value, Sequence) else (value, value)
        if not (front > 0 and rear > 0):
            raise ValueError(f"effect {self.name!r}: {what} is {value}: must be above 0")
        return float(front), float(rear)

    @property
    def options(self) -> dict[str, Any]:
        chosen = {
            "friction": (self.friction, (FRICTION, FRICTION)),
            "stiffness": (self.stiffness, STIFFNESS),
            "shape": (self.shape, SHAPE),
            "speed_loss": (self.speed_loss, SPEED_LOSS),
            "resistance": (self.resistance, RESISTANCE),
        }
        changed = {name: list(mine) for name, (mine, own) in chosen.items() if mine != own}
        numbers = {
            "height": (self.height, HEIGHT),
            "front_drive_share": (self._driving.front, FRONT_DRIVE_SHARE),
        }
        changed |= {name: mine for name, (mine, own) in numbers.items() if mine != own}
        return super().options | changed

    @abstractmethod
    def _ratios(self, motion: Motion) -> tuple[Tensor, Tensor]:
        """Friction over the engine's [n], front and rear."""

    def _bounded(self, force: Tensor, load: Tensor) -> Tensor:
        """A last bound on the lateral forces [n, 2] at their static loads [2] over weight."""
        return force

    def _change(self, motion: Motion) -> Tensor:
        return self._carried_on(motion)[0]

    def _carried_on(self, motion: Motion) -> tuple[Tensor, Tensor]:
        d = self.dimensions
        ax, ay, _ = motion.acceleration
        ratio = torch.stack(torch.broadcast_tensors(*self._ratios(motion), ax)[:2], -1)  # (n, 2)
        share = ax.new_tensor([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
        shape = ax.new_tensor(self.shape)
        resists = self._resists(motion)
        load = self._load(share, ax + resists)  # (n, 2) over mass
        circle = load * ax.new_tensor(self.friction)
        mean, angle, couple, drive = self._seen(motion, share, circle[..., 0], resists)
        hold = share * (motion.turn_rate * motion.after[..., 0]).unsqueeze(-1)
        hold = hold - _in_front(self._steered(drive, angle))
        lost = (self.speed_loss[0] + self.speed_loss[1] * motion.drive).clamp_min(0.0)
        assert motion.carried is not None
        along, aside, aside_now, extra = self._driving.driven(
            motion.carried, drive, lost, circle, ratio, self._across(motion, angle), self.dt
        )
        turned = torch.stack([torch.cos(angle), torch.ones_like(angle)], -1)
        side = turned * circle * aside
        side_now = turned * ratio * circle * aside_now
        pushed = (along * turned).sum(-1)

        speed = motion.after[..., 0].abs().clamp_min(SLOWEST).unsqueeze(-1)
        rate = self.dt * ax.new_tensor(self.stiffness) * load / speed  # (n, 2) K dt at no slip
        slip = slip_of(mean / side, shape)
        start = hold + self._unsettled(mean - hold, rate * slope(slip, shape))
        slip = slip_of(start / side, shape)
        stiff, stiff_now = slope(slip, shape), slope(slip / ratio, shape)
        start = hold + self._unsettled(mean - hold, rate * stiff)
        use = start / side
        gained = torch.zeros_like(ax)
        for _ in range(LEANING):
            leans = self._load(share, ax + resists + gained) / load
            start_now = self._bounded(self._held(start, use, side, leans * side_now, ratio), share)
            mean_now = hold + self._settled(start_now - hold, rate * stiff_now)
            gained = pushed - (mean_now - mean)[..., 0] * torch.tan(angle)

        front, rear = (mean_now - mean).unbind(-1)
        front = front + along[..., 0] * torch.sin(angle)
        couple_now = self._couple(ay + front + rear, mean_now[..., 0], angle)
        moment = d.cg_to_front_axle * front - d.cg_to_rear_axle * rear - (couple_now - couple)
        yaw = d.mass / d.yaw_inertia * moment
        return self.dt * torch.stack([gained, front + rear, yaw], -1), extra

    def _seen(
        self, motion: Motion, share: Tensor, circle: Tensor, resists: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What tyres did: sideways [n, 2]; where front wheels point [n] [rad]; their couple; drive.

        Of the front axle's force to the side of the car, what its drive gives there is not counted.
        """
        d = self.dimensions
        _, ay, yaw = motion.acceleration
        inertia = d.yaw_inertia / d.mass * yaw
        mean = share * ay.unsqueeze(-1)
        angle = couple = drive = torch.zeros_like(ay)
        for _ in range(LEANING):
            spin = (inertia + couple) / d.wheelbase
            mean = share * ay.unsqueeze(-1) + torch.stack([spin, -spin], -1)
            mean = mean - _in_front(self._steered(drive, angle))
            angle = self._wheel_angle(motion, mean[..., 0] / circle)
            angle = self._wheel_angle(motion, mean[..., 0] / circle / torch.cos(angle))
            couple = self._couple(ay, mean[..., 0], angle)
            drive = self._drive(motion, mean[..., 0], angle, resists)
        return mean, angle, couple, drive

    def _drive(self, motion: Motion, front: Tensor, angle: Tensor, resists: Tensor) -> Tensor:
        """Over mass [n] [m/s^2], along the treads of both axles, by what it did to the car."""
        felt = 1 - self._driving.front * (1 - torch.cos(angle))
        ax = motion.acceleration[0]
        drive = ((ax + front * torch.tan(angle) + resists) / felt).clamp_min(0.0)
        return drive * torch.tanh(motion.drive / ASKED)

    def _steered(self, drive: Tensor, angle: Tensor) -> Tensor:
        """What a front axle that drives [n] gives to the side of the car [n]."""
        return self._driving.front * drive * torch.sin(angle)

    def _held(
        self, start: Tensor, use: Tensor, side: Tensor, side_now: Tensor, ratio: Tensor
    ) -> Tensor:
        """Forces [n, 2] at the slips at which the engine's axles give `start`, `use` of `side`."""
        shape = use.new_tensor(self.shape)
        slip = slip_of(use, shape) / ratio
        # The force itself where ratio = 1: law and inverse then cancel to the last digits only.
        change = side_now * law(slip, shape) - side * law(slip * ratio, shape)
        slides = side_now / side * start
        holds = ((1 - use.abs()) / (1 - HOLDS)).clamp(0.0, 1.0)
        return slides + holds * (start + torch.sign(start) * change - slides)

    def _load(self, share: Tensor, given: Tensor) -> Tensor:
        """Load of each axle over the mass [n, 2], where tyres give [n] [m/s^2] lengthwise."""
        lift = self.height / self.dimensions.wheelbase * share.new_tensor([-1.0, 1.0])
        return (GRAVITY * share + lift * given.unsqueeze(-1)).clamp_min(LEAST_LOAD * GRAVITY)

    def _couple(self, ay: Tensor, front: Tensor, angle: Tensor) -> Tensor:
        """Moment over mass [n] [m^2/s^2] of an outer front wheel that brakes more."""
        return self.height / GRAVITY * ay * torch.sin(angle) * front

    def _resists(self, motion: Motion) -> Tensor:
        """What resists at the body [n] [m/s^2]."""
        vx = motion.after[..., 0]
        return self.resistance[0] * torch.tanh(vx / SETTING_OFF) + self.resistance[1] * vx

    def _across(self, motion: Motion, angle: Tensor) -> Tensor:
        """Speed [n, 2] [m/s] past which a spinning wheel slides: sideways, or by its stretch."""
        d = self.dimensions
        vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
        front = (vy + d.cg_to_front_axle * yaw_rate) * torch.cos(angle) - vx * torch.sin(angle)
        sideways = torch.stack([front, vy - d.cg_to_rear_axle * yaw_rate], -1)
        friction = vx.new_tensor(self.friction)
        stretch = friction / LENGTHWISE * vx.abs().clamp_min(SLOWEST).unsqueeze(-1)
        return (sideways.square() + stretch.square()).sqrt()

    def _wheel_angle(self, motion: Motion, use: Tensor) -> Tensor:
        """Where the front wheels point [n] [rad]: as their axle moves, and by its slip from it."""
        vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
        moves = torch.atan2(vy + self.dimensions.cg_to_front_axle * yaw_rate, vx.clamp_min(SLOWEST))
        c = self.shape[0]
        slip = torch.sign(use) * slip_of(use, use.new_tensor(c))
        return (moves + slip * (c * self.friction[0] / self.stiffness[0])).clamp(-LOCK, LOCK)

    def _mobility(self) -> tuple[float, float, float]:
        """S times mass: how an axle's slip speeds up with its own force, and with the other's."""
        d = self.dimensions
        a, b, i = d.cg_to_front_axle, d.cg_to_rear_axle, d.yaw_inertia / d.mass
        return 1 + a * a / i, 1 - a * b / i, 1 + b * b / i

    def _unsettled(self, mean: Tensor, rate: Tensor) -> Tensor:
        """(1 + X / 2) of a force [n, 2]: from its mean over the step to its start."""
        ff, fr, rr = self._mobility()
        front, rear = mean.unbind(-1)
        slip = torch.stack([ff * front + fr * rear, fr * front + rr * rear], -1)
        return mean + 0.5 * rate * slip

    def _settled(self, start: Tensor, rate: Tensor) -> Tensor:
        """(1 + X / 2)^-1 of a force [n, 2], by Cramer's rule."""
        ff, fr, rr = self._mobility()
        front, rear = (0.5 * rate).unbind(-1)
        p, q, r, s = 1 + front * ff, front * fr, rear * fr, 1 + rear * rr
        x, y = start.unbind(-1)
        return torch.stack([s * x - q * y, p * y - r * x], -1) / (p * s - q * r).unsqueeze(-1)


def _in_front(force: Tensor) -> Tensor:
    """[n, 2] of front and rear axle: [n] in front."""
    return torch.stack([force, torch.zeros_like(force)], -1)
