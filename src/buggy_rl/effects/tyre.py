"""Tyres that hold less than the simulated ones, around a simulator whose tyres cannot be seen.

From what the engine did in a step follow the accelerations, and from those what each axle gave
sideways, per mass of the car [m/s^2], with the axles a ahead of and b behind the centre of gravity:

    F_front = (ay b + I/m dr/dt) / L,   F_rear = (ay a - I/m dr/dt) / L.

These are changed and put back. Four things matter.

- *Friction is a bound, not a factor.* On a slippery floor a tyre is as stiff as ever and slides
  earlier: F'(slip) = g F(slip / g). With F = D sin(c atan(s)), s = C slip / (c D), the slip is read
  off the force, s = tan(asin(F / D) / c), and F' = g D sin(c atan(s / g)): F as long as the tyre
  holds, g F where it slides.
- *Within a step forces relax.* At 2 m/s the slip of this car settles in about one period, so what
  is seen is a mean over the settling, not what the tyre gives at the slip the step began with. With
  the slip's rate d(slip)/dt = S (F - F_hold), S the mobility of the axles, F_hold what keeps the
  turn as it is, the mean is F_hold + (1 + X / 2)^-1 (F_start - F_hold), X = dt S K, K the slope of
  the tyre law. It is undone with the engine's slope and done again with the changed one.
- *Front wheels push square to where they point*, so a part of their force brakes.
- *The rear axle also drives, and spins* where that is more than its friction. A sliding tyre pushes
  against the way its tread slides: with a tread u faster than the ground that slides w sideways,
  F_x / F = u / sqrt(u^2 + w^2) and F_y / F = w / sqrt(u^2 + w^2), w no less than what it stretches
  by. So a car that spins its wheels has nothing left for the side. The simulated u follows from the
  drive seen; by how much the changed one is larger, z, is a state of the effect:
  wheels dz/dt = drive - b z - F_x, b what the motor loses with the speed. The reference car on a
  floor of grip 0.58 spins its wheels by up to 9 m/s; told its motion, the effect's u is on average
  10 to 17 % below the car's where that is above 1 m/s, and up to a half below it under 0.3 m/s.

Loads are those at rest. Shifting them by ax h / L was tried and made the yaw moment worse around
every engine, those with load transfer included: what brakes a car is not all at the tyres.

The engine's own tyres D, C, c are assumed; `measured_tyres` finds them for a simulator.
"""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter, one_in
from buggy_rl.effects.motion.base import LOCK, Motion, MotionEffect
from buggy_rl.effects.motion.drive import ASKED, SPEED_LOSS
from buggy_rl.vehicle import GRAVITY

Axles = float | Sequence[float]

FRICTION = 0.84  # D over load, DART's 0.84 front and 0.85 rear
STIFFNESS = (6.1, 9.4)  # [1/rad] C over load, front and rear: DART's B C D
SHAPE = (1.2, 1.2)  # c, between a tyre that bends over slowly (1) and a brush (1.4); chosen
SLOWEST = 0.5  # [m/s] below it slip settles no faster; engines, too, soften tyres at a crawl
LENGTHWISE = 13.0  # [-] longitudinal force over load and slip, at small slip; chosen
WHEELS = 0.085  # what turns with the rear wheels, as a mass at their tread over the car's; chosen
NEWTON = 6  # iterations; of 200 000 drawn cases the worst is 5e-9 m/s off
FULL_CIRCLE = 0.95  # share of the friction circle that a drive can use up; chosen
MOST_USED = 0.995  # of its bound; a tyre that gives more is taken to slide
NO_BOUND = 1000.0  # [m/s^2] more than any tyre gives
EDGE = 0.05  # [m] of a patch: over twice this its grip changes from 12 to 88 %


class TyreEffect(MotionEffect):
    """Axle forces as another friction would have made them.

    Args:
        friction: Largest tyre force over load that the engine has: one number, or front and rear.
        stiffness: Its lateral force over load and slip angle, at small slip [1/rad]; likewise.
        shape: c of its law, likewise.
        speed_loss: b0 and b1 [1/s] of what its motor loses with the speed, b = b0 + b1 drive.
        dimensions, dt, values: As for the other motion effects.

    Raises:
        ValueError: One of them is not above 0.
    """

    def __init__(
        self,
        *,
        friction: Axles = FRICTION,
        stiffness: Axles = STIFFNESS,
        shape: Axles = SHAPE,
        speed_loss: Sequence[float] = SPEED_LOSS,
        **rest: Any,
    ) -> None:
        self.speed_loss = (float(speed_loss[0]), float(speed_loss[1]))
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
        }
        changed = {name: list(mine) for name, (mine, own) in chosen.items() if mine != own}
        return super().options | changed

    carries = 1

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
        ax, ay, yaw = motion.acceleration
        ratio = torch.stack(torch.broadcast_tensors(*self._ratios(motion), ax)[:2], -1)  # (n, 2)
        share = ax.new_tensor([d.cg_to_rear_axle, d.cg_to_front_axle]) / d.wheelbase
        load = GRAVITY * share  # (2,) over mass
        spin = d.yaw_inertia / d.mass / d.wheelbase * yaw
        mean = share * ay.unsqueeze(-1) + torch.stack([spin, -spin], -1)  # (n, 2) front, rear
        hold = share * (motion.turn_rate * motion.after[..., 0]).unsqueeze(-1)

        circle = load * torch.ones_like(ratio) * ax.new_tensor(self.friction)  # (n, 2)
        shape = ax.new_tensor(self.shape)
        angle = self._wheel_angle(motion, mean[..., 0] / circle[..., 0])
        aside = torch.stack([torch.cos(angle), torch.ones_like(angle)], -1)
        drive = (ax + mean[..., 0] * torch.tan(angle)).clamp_min(0.0)
        drive = drive * torch.tanh(motion.drive / ASKED)
        rear, rear_now = circle[..., 1], (ratio * circle)[..., 1]
        across = self._across(motion)
        spins = spin_of(drive, rear, across)
        pull = lengthwise(spins, rear, across)  # the drive, but no more than friction gives
        extra = self._spun(motion, pull, rear_now, across, spins)
        driven = drive * lengthwise(spins + extra, rear_now, across) / pull
        side = aside * circle * left(spins, across)
        side_now = aside * ratio * circle * left(spins + extra, across)

        speed = motion.after[..., 0].abs().clamp_min(SLOWEST).unsqueeze(-1)
        rate = self.dt * ax.new_tensor(self.stiffness) * load / speed  # (n, 2) K dt at no slip
        slip = slip_of(mean / side, shape)
        start = hold + self._unsettled(mean - hold, rate * slope(slip, shape))
        slip = slip_of(start / side, shape)
        stiff, stiff_now = slope(slip, shape), slope(slip / ratio, shape)
        start = hold + self._unsettled(mean - hold, rate * stiff)
        slip = slip_of(start / side, shape) / ratio
        # The force itself where ratio = 1: law and inverse then cancel to the last digits only.
        start_now = start + torch.sign(start) * (
            side_now * law(slip, shape) - side * law(slip * ratio, shape)
        )
        start_now = self._bounded(start_now, share)
        mean_now = hold + self._settled(start_now - hold, rate * stiff_now)

        change = mean_now - mean  # (n, 2)
        front, rear = change.unbind(-1)
        moment = d.mass / d.yaw_inertia * (d.cg_to_front_axle * front - d.cg_to_rear_axle * rear)
        forward = driven - drive - front * torch.tan(angle)
        change = self.dt * torch.stack([forward, front + rear, moment], -1)
        return change, extra.unsqueeze(-1)

    def _across(self, motion: Motion) -> Tensor:
        """Speed [n] [m/s] past which a spinning rear wheel slides: sideways, or by its stretch."""
        vx, vy, yaw_rate = (0.5 * (motion.before + motion.after)).unbind(-1)
        sideways = vy - self.dimensions.cg_to_rear_axle * yaw_rate
        stretch = self.friction[1] / LENGTHWISE * vx.abs().clamp_min(SLOWEST)
        return (sideways.square() + stretch.square()).sqrt()

    def _spun(
        self, motion: Motion, pull: Tensor, circle: Tensor, across: Tensor, spins: Tensor
    ) -> Tensor:
        """How much faster than the simulated the rear treads run [n] [m/s] after the step.

        wheels dz/dt = pull - b z - F(spins + z), by the implicit Euler rule and Newton's.
        """
        assert motion.carried is not None
        before = motion.carried.squeeze(-1)
        lost = (self.speed_loss[0] + self.speed_loss[1] * motion.drive).clamp_min(0.0)
        step = self.dt / WHEELS
        z = before
        for _ in range(NEWTON):
            faster = (spins + z).clamp_min(0.0)
            root = (faster.square() + across.square()).sqrt()
            gap = z - before - step * (pull - lost * z - circle * faster / root)
            slope_ = 1 + step * (lost + circle * across.square() / root**3)
            z = torch.maximum(z - gap / slope_, -spins)
        return z

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


def spin_of(drive: Tensor, circle: Tensor, across: Tensor) -> Tensor:
    """Spin [n] [m/s] of rear wheels that give a drive [n], of a friction circle [n]."""
    use = drive.clamp_min(1e-6).minimum(FULL_CIRCLE * circle) / circle
    return across * use / (1 - use.square()).sqrt()


def lengthwise(spin: Tensor, circle: Tensor, across: Tensor) -> Tensor:
    """Drive [n] of rear wheels that spin by [n]: the force points where the tread slides."""
    return circle * spin / (spin.square() + across.square()).sqrt()


def left(spin: Tensor, across: Tensor) -> Tensor:
    """Share [n, 2] of friction circles that is left for the side: all of it in front."""
    rear = across / (spin.square() + across.square()).sqrt()
    return torch.stack([torch.ones_like(rear), rear], -1)


def slip_of(use: Tensor, shape: Tensor) -> Tensor:
    """Slip s >= 0 at which a tyre gives a share u of its bound: s = tan(asin(|u|) / c)."""
    return torch.tan(torch.asin(use.abs().clamp_max(MOST_USED)) / shape)


def law(slip: Tensor, shape: Tensor) -> Tensor:
    """Share of its bound that a tyre gives at s >= 0: sin(c atan(s))."""
    return torch.sin(shape * torch.atan(slip))


def slope(slip: Tensor, shape: Tensor) -> Tensor:
    """Slope of the law over that at no slip, not below 0: cos(c atan(s)) / (1 + s^2)."""
    return torch.cos(shape * torch.atan(slip)).clamp_min(0.0) / (1 + slip.square())


class TireGrip(TyreEffect):
    """Less friction than simulated, on both axles; or a bound on the lateral acceleration.

    `max_acceleration` is shared between the axles in proportion to their loads.
    """

    name = "tire_grip"
    equation = "|F_axle| <= grip friction load, at the same stiffness; |ay| <= max_acceleration"
    alternatives = ("max_acceleration",)
    parameters = (
        EffectParameter("grip", 1.0, 0.1, 2.5, "-", "Friction over the simulated.", 0.2, -0.03),
        EffectParameter(
            "max_acceleration",
            NO_BOUND,
            0.5,
            NO_BOUND,
            "m/s^2",
            "Largest lateral acceleration that the tyres give.",
            size=6.0,
            probe=6.0 - NO_BOUND,
            reciprocal=True,
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        grip, most = values.get("grip", 1.0), values.get("max_acceleration", NO_BOUND)
        words = []
        if grip != 1.0 or most >= NO_BOUND:
            words.append(f"the tyres hold {one_in(grip)} than simulated before they slide")
        if most < NO_BOUND:
            words.append(f"the tyres give at most {most / GRAVITY:.2g} g sideways")
        return ", and ".join(words)

    def _ratios(self, motion: Motion) -> tuple[Tensor, Tensor]:
        grip = self._here("grip").clamp_min(1e-2)
        return grip, grip

    def _bounded(self, force: Tensor, load: Tensor) -> Tensor:
        most = self._here("max_acceleration").unsqueeze(-1) * load
        return torch.minimum(torch.maximum(force, -most), most)


class GripBalance(TyreEffect):
    """One axle holds more than simulated, the other less, their product as it was."""

    name = "grip_balance"
    equation = "front friction sqrt(q), rear friction / sqrt(q), at the same stiffness"
    parameters = (
        EffectParameter(
            "front_to_rear",
            1.0,
            0.2,
            5.0,
            "-",
            "Front friction over rear, over simulated.",
            0.2,
            0.03,
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ratio = values["front_to_rear"]
        end = "nose pushes outwards" if ratio < 1 else "tail comes round"
        return f"the {end} earlier: front against rear, the tyres hold {one_in(ratio)}"

    def _ratios(self, motion: Motion) -> tuple[Tensor, Tensor]:
        front = self._here("front_to_rear").clamp_min(1e-2).sqrt()
        return front, 1 / front


class GripPatch(TyreEffect):
    """A slippery place: `tire_grip` inside of a circle, with an edge of some centimetres."""

    name = "grip_patch"
    equation = "tire_grip within radius of (x, y)"
    deciding = ("grip",)
    parameters = (
        EffectParameter("x", 0.0, -1000.0, 1000.0, "m", "Middle of the place, world.", 2.0, 0.1),
        EffectParameter("y", 0.0, -1000.0, 1000.0, "m", "Middle of the place, world.", 2.0, 0.1),
        EffectParameter("radius", 0.5, 0.05, 100.0, "m", "Of the place.", 0.5, 0.1),
        EffectParameter("grip", 1.0, 0.1, 2.5, "-", "Friction over the simulated.", 0.3, -0.03),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            f"within {values['radius']:.2g} m of ({values['x']:.2f}, {values['y']:.2f}) m the "
            f"tyres hold {one_in(values['grip'])} than simulated"
        )

    def _ratios(self, motion: Motion) -> tuple[Tensor, Tensor]:
        away = motion.pose[..., :2] - torch.stack([self._here("x"), self._here("y")], -1)
        distance = (away.square().sum(-1) + 1e-12).sqrt()
        inside = torch.sigmoid((self._here("radius") - distance) / EDGE)
        grip = 1 + (self._here("grip").clamp_min(1e-2) - 1) * inside
        return grip, grip
