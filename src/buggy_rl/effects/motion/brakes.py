"""Brakes that a simulator lacks, or that act at other wheels than simulated."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import LOCK, Motion, MotionEffect, along
from buggy_rl.effects.motion.resistance import STOPPING, slowed
from buggy_rl.effects.motion.steered import left_by_tyres
from buggy_rl.vehicle import GRAVITY

IDLE = 0.01  # [-] drive beyond the dead zone at which the drag brake is off; chosen
ROLLS = 0.2  # [m/s] forward speed from which all of a command below 0 is brake; chosen
SLOWEST = 0.3  # [m/s] speed below which an arc is no tighter; chosen
USED = 0.95  # [-] largest share of its friction that a brake is taken to use; chosen


class DragBrake(MotionEffect):
    """A brake that is on while the command is within the dead zone: at most to a stop."""

    name = "drag_brake"
    look_at = "Check the drag brake that is set in the speed controller."
    equation = "dvx/dt = -deceleration tanh(vx / 0.05 m/s) without a command"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 3 (constant retardation)"
    declared = (
        EffectParameter(
            "deceleration", 0.0, 0.0, 10.0, "m/s^2", "Without a command.", size=0.8, probe=0.1
        ),
    )
    option_names = ("onset", "reverse_onset")
    onset: float = 0.0
    """Drive in 0..1 at which the simulated motor begins to give force."""
    reverse_onset: float = 0.0
    """Likewise of brake and reverse."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["deceleration"]
        return f"without a command a brake takes {loss:.3g} m/s a second from the car"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        if motion.asked is None:  # without reverse there is no such brake
            return along(torch.zeros_like(vx))
        forward = (motion.asked - self.onset).clamp_min(0.0)
        backward = (-motion.asked - self.reverse_onset).clamp_min(0.0)
        idle = (1 - (forward + backward) / IDLE).clamp_min(0.0)
        loss = self._value("deceleration") * idle * torch.tanh(vx.abs() / STOPPING)
        return along(slowed(vx, loss * self.dt))


class BrakeBalance(MotionEffect):
    """Part of the brake force at the other axle: X moves from the rear axle to the front one.

    X = shift B b, with B the deceleration of the simulated brakes at full command and b the
    command. At a road-wheel angle delta it adds -X (cos(delta) - 1) along, -X sin(delta) across
    and the moment of that. By the friction ellipse the side force of an axle with brake force x
    (over friction times load) changes by sqrt((1 - x'^2) / (1 - x^2)). What the tyres take back
    within the step is as in `yaw.YawEffect`, for both axles together.
    """

    name = "brake_balance"
    look_at = "Check which axle brakes how much: differentials, slipper clutch, a mechanical brake."
    equation = "front brake share' = front brake share + shift"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 3 (brake proportioning)"
    declared = (
        EffectParameter(
            "shift", 0.0, -1.0, 1.0, "-", "Added to the share of the brakes in front.", 0.3, 0.05
        ),
    )
    option_names = (
        "braking",
        "reverse_onset",
        "brake_front_share",
        "friction",
        "stiffness",
        "lock",
    )
    braking: float = 5.0
    """B [m/s^2]."""
    reverse_onset: float = 0.0
    """Drive in 0..1 at which the simulated brake begins."""
    brake_front_share: float = 0.0
    """Share of the simulated brakes at the front axle, 0..1."""
    friction: tuple[float, float] = (0.84, 0.84)
    """Friction of the simulated front and rear axle; DART."""
    stiffness: tuple[float, float] = (0.0, 0.0)
    """Cornering stiffness over load of both axles [1/rad]; 0 for a simulator without tyres."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share, to = 100 * abs(values["shift"]), "front" if values["shift"] >= 0 else "rear"
        return f"{share:.3g} % of the brake force acts at the {to} axle instead of the other"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        if motion.asked is None:
            return along(torch.zeros_like(vx))
        span = max(1 - self.reverse_onset, 1e-3)
        pressed = (-motion.asked - self.reverse_onset).clamp_min(0.0) / span
        force = self.braking * pressed * (vx / ROLLS).clamp(0.0, 1.0)
        share = self.brake_front_share + self._value("shift")
        moved = (share.clamp(0.0, 1.0) - self.brake_front_share) * force
        d = self.dimensions
        angle = d.wheelbase * motion.turn_rate / motion.rolling(SLOWEST)
        angle = angle.clamp(-self.lock, self.lock)
        front, rear = self._side_changes(motion, force, moved)
        front = front * torch.cos(angle) - moved * torch.sin(angle)
        front, rear = left_by_tyres(motion, d, self.stiffness, front, rear)
        moment = d.cg_to_front_axle * front - d.cg_to_rear_axle * rear
        yaw = d.mass / d.yaw_inertia * moment
        ahead = -moved * (torch.cos(angle) - 1)
        return self.dt * torch.stack([ahead, front + rear, yaw], -1)

    def _side_changes(self, motion: Motion, force: Tensor, moved: Tensor) -> tuple[Tensor, Tensor]:
        """Change of both side forces [n] over mass, by the friction ellipse."""
        d = self.dimensions
        _, ay, yaw = motion.acceleration
        front = (d.cg_to_rear_axle * ay + d.yaw_inertia / d.mass * yaw) / d.wheelbase
        lift = d.cg_height / d.wheelbase * force
        load = GRAVITY * d.cg_to_rear_axle / d.wheelbase + lift
        behind = (GRAVITY * d.cg_to_front_axle / d.wheelbase - lift).clamp_min(0.1 * GRAVITY)
        own = self.brake_front_share * force
        sides = (front, self.friction[0] * load, own, own + moved)
        rest = force - own
        return _scaled(*sides), _scaled(ay - front, self.friction[1] * behind, rest, rest - moved)


def _scaled(side: Tensor, circle: Tensor, brake: Tensor, changed: Tensor) -> Tensor:
    """Change of a side force [n] by another brake force [n] of its axle, all over mass."""
    before, after = (1 - (x / circle).clamp(0.0, USED).square() for x in (brake, changed))
    return side * ((after / before).sqrt() - 1)
