"""Yaw moments of the driven wheels: by the motor's force, and by a differential that is stiff."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import LOCK, TYPICAL_STIFFNESS, Motion, MotionEffect
from buggy_rl.effects.motion.drive import drive_of_motor
from buggy_rl.effects.motion.steered import FrontAxle, left_by_tyres, steered_angle
from buggy_rl.effects.motion.yaw import SLOWEST, YawEffect, tyre_damping
from buggy_rl.effects.tyre.law import law, slip_of

FRICTION = 0.84  # [-] of DART's axles, 0.84 and 0.85
SLIP_STIFFNESS = 13.0  # [-] longitudinal force over load and slip ratio at small slip; chosen
CREEPING = 0.1  # [m/s] speed below which wheels slip as at it; chosen
LITTLE = 1e-6  # in place of 0 under a fraction: of a slip [-], a force over mass, a yaw rate


class TorqueSteer(YawEffect):
    """Yaw moment in proportion to the force of the motor.

    One driven wheel pushes more than the other, by its size, its tyre, or a chassis that the
    motor's torque rolls. `offset` is where the force would have to act: y to the left of the
    middle, so that a negative one turns the car to the left. The motor's force is read off the
    motion as in `MotorEffect`.
    """

    name = "torque_steer"
    look_at = (
        "Lift the car and open the throttle: do both wheels pull alike? Check the differential."
    )
    equation = "dr/dt = -offset (m / I) (drive acceleration)"
    source = (
        "Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., ch. 8 (yaw moment of unequal left "
        "and right longitudinal forces)"
    )
    declared = (
        EffectParameter(
            "offset",
            0.0,
            -0.2,
            0.2,
            "m",
            "Of the motor's force, to the left of the middle.",
            size=0.006,
            probe=0.001,
            usual=(-0.012, 0.012),
        ),
    )
    option_names = ("stiffness", "coasting", "lock")
    coasting: tuple[float, float] = (0.5, 0.25)
    """c0 [m/s^2] and c1 [1/s] of the coasting simulated car; those of the single-track buggy."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        side, off = "left" if values["offset"] <= 0 else "right", 1000 * abs(values["offset"])
        return (
            f"under throttle the car pulls to the {side}, as if the motor pushed {off:.3g} mm "
            "beside the middle"
        )

    def _moment_change(self, motion: Motion) -> Tensor:
        d = self.dimensions
        moved = drive_of_motor(motion, d, self.coasting, self.lock)
        return -self._value("offset") * (d.mass / d.yaw_inertia) * moved * self.dt


class StiffDifferential(MotionEffect):
    """A rear axle whose wheels turn alike, wholly or in part: it resists turning.

    The wheels of a locked axle roll at one speed, and slip by kappa = t r / (2 |vx|), the inner
    one forward and the outer one back. Each shares its friction between what the motor asks of it,
    the side force and that: with s_0 and s_y the slips of both,

        s_x = s_0 +- coupling C kappa / (c D),   (X, Y) = D N sin(c atan(s)) / s (s_x, s_y),

    s = |(s_x, s_y)|. The difference of X turns the car, Y less than before lets the axle slip, and
    what the front tyres give against the couple pulls back along turned wheels.
    """

    name = "stiff_differential"
    look_at = "Turn one driven wheel by hand with the other: differential oil, or a locked axle."
    equation = (
        "dr/dt = -(t / 2 I) (X_inner - X_outer), X = D N sin(c atan(s)) s_x / s, "
        "s_x = s_0 +- coupling C t r / (2 c D |vx|)"
    )
    source = (
        "Milliken & Milliken 1995, Race Car Vehicle Dynamics, ch. 20 (driving: differentials); "
        "Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 4.3.1 (combined slip)"
    )
    declared = (
        EffectParameter(
            "coupling",
            0.0,
            -0.2,
            1.5,
            "-",
            "Slip of the driven wheels over that of a locked axle.",
            size=0.4,
            probe=0.03,
            usual=(0.0, 1.0),
        ),
    )
    option_names = ("stiffness", "friction", "shape", "coasting", "lock")
    stiffness: tuple[float, float] = TYPICAL_STIFFNESS
    """C of the simulator's front and rear axle [1/rad]; 0 for a simulator without tyres."""
    friction: tuple[float, float] = (FRICTION, FRICTION)
    """D of its axles."""
    shape: tuple[float, float] = (1.2, 1.2)
    """c of its axles; chosen."""
    coasting: tuple[float, float] = (0.5, 0.25)
    """c0 [m/s^2] and c1 [1/s] of the coasting simulated car; those of the single-track buggy."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 100 * values["coupling"]
        return (
            f"the wheels of the driven axle turn alike, {share:.3g} % of the way to a locked "
            "differential: the car runs wider in every bend, in slow ones too"
        )

    def _change(self, motion: Motion) -> Tensor:
        d, dt = self.dimensions, self.dt
        inertia = d.yaw_inertia / d.mass
        # Forces of both rear tyres over the car's mass: the friction, and what they give of it.
        most = self.friction[1] * GRAVITY * d.cg_to_front_axle / d.wheelbase
        _, ay, turning = motion.acceleration
        side = (d.cg_to_front_axle * ay - inertia * turning) / d.wheelbase
        drive = drive_of_motor(motion, d, self.coasting, self.lock)
        used = torch.hypot(drive, side).clamp_min(LITTLE)
        shape = torch.as_tensor(self.shape[1]).to(ay)
        slip = slip_of(used / most, shape) / used
        ahead, across = slip * drive, slip * side
        # Slip along the wheels over the yaw rate: forward of the inner one, back of the outer one.
        speed, half, rate = motion.after[..., 0].abs(), 0.5 * d.track_width, motion.after[..., 2]
        along = self._value("coupling") * SLIP_STIFFNESS * half / speed.clamp_min(CREEPING)
        along = along / (shape * self.friction[1])
        sides = ahead, ahead + along * rate, ahead - along * rate
        before, inner, outer = (
            most * _over_slip(torch.hypot(own, across), shape) * torch.stack([own, across])
            for own in sides
        )  # (2, n) force along and across of an open axle, and of both wheels as if of two
        # At a crawl the couple is so steep in the yaw rate that it changes within the step.
        still = torch.where(rate.abs() < LITTLE, LITTLE, rate)
        damping = 0.5 * half * (inner[0] - outer[0]) / (still * inertia)
        tyres = tyre_damping(d, self.stiffness) / speed.clamp_min(SLOWEST)
        damping = damping / (1 + 0.5 * dt * damping / (1 + 0.5 * dt * tyres))
        couple = -inertia / d.wheelbase * damping * rate * dt
        lost = (before[1] - 0.5 * (inner[1] + outer[1])) * dt
        front, rear = left_by_tyres(motion, d, self.stiffness, couple, -couple - lost)
        axle = FrontAxle(self.stiffness[0], self.friction[0], self.shape[0], self.lock)
        back = (couple - front) * torch.sin(steered_angle(motion, d, axle))
        yaw = (d.cg_to_front_axle * front - d.cg_to_rear_axle * rear) / inertia
        return torch.stack([back, front + rear, yaw], -1)


def _over_slip(slip: Tensor, shape: Tensor) -> Tensor:
    slip = slip.clamp_min(LITTLE)
    return law(slip, shape) / slip
