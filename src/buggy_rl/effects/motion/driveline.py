"""Yaw moments of the driven wheels: by the motor's force, and by a differential that is stiff."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import LOCK, TYPICAL_STIFFNESS, Motion
from buggy_rl.effects.motion.drive import drive_of_motor
from buggy_rl.effects.motion.yaw import SLOWEST, YawEffect

FRICTION = 0.84  # [-] of DART's axles, 0.84 and 0.85
SLIP_STIFFNESS = 13.0  # [-] longitudinal force over load and slip ratio at small slip; chosen


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


class StiffDifferential(YawEffect):
    """A rear axle whose wheels turn alike, wholly or in part: it resists turning.

    The wheels of a locked axle roll at one speed, and slip by kappa = t r / (2 |vx|), the inner
    one forward and the outer one back. Their forces N C kappa, at most N D, are a couple

        M = t (N / 2) D tanh(C kappa / D),  exact over a step where it is linear.

    A share `coupling` of it is that of a limited-slip or tight gear differential.
    """

    name = "stiff_differential"
    look_at = "Turn one driven wheel by hand with the other: differential oil, or a locked axle."
    equation = "dr/dt = -coupling (t N_r / 2 I) D tanh(C t r / (2 D |vx|))"
    source = "Milliken & Milliken 1995, Race Car Vehicle Dynamics, ch. 20 (driving: differentials)"
    declared = (
        EffectParameter(
            "coupling",
            0.0,
            -0.2,
            1.5,
            "-",
            "Yaw moment over that of a locked axle.",
            size=0.4,
            probe=0.03,
            usual=(0.0, 1.0),
        ),
    )
    option_names = ("stiffness", "friction")
    stiffness: tuple[float, float] = TYPICAL_STIFFNESS
    friction: tuple[float, float] = (FRICTION, FRICTION)
    """D of the simulator's front and rear axle."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 100 * values["coupling"]
        return (
            f"the wheels of the driven axle turn alike, {share:.3g} % of the way to a locked "
            "differential: the car runs wider in every bend, in slow ones too"
        )

    def _moment_change(self, motion: Motion) -> Tensor:
        d, friction = self.dimensions, self.friction[1]
        rate = motion.after[..., 2]
        half = 0.5 * d.track_width
        # Of both rear wheels, whose load over mass is g a / L [1/s^2].
        most = (
            half * (d.mass / d.yaw_inertia) * friction * GRAVITY * d.cg_to_front_axle / d.wheelbase
        )
        use = SLIP_STIFFNESS / friction * half / motion.after[..., 0].abs().clamp_min(SLOWEST)
        used = (use * rate).abs().clamp_min(1e-6)
        # What a linear moment takes in a step, and the share of it that a saturated one has.
        taken = torch.expm1(-self._value("coupling") * most * use * self.dt)
        return rate * taken * torch.tanh(used) / used
