"""Yaw moments, and the share of them that the tyres leave at the end of a step."""

import math
from abc import abstractmethod
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect, turning
from buggy_rl.vehicle import GRAVITY

SLOWEST = 0.5  # [m/s] speed below which the yaw damping of the tyres grows no further; chosen
ROLLING = 0.3  # [m/s] speed at which a dragging wheel is at tanh(1) = 76 % of its force; chosen


class YawEffect(MotionEffect):
    """dr = dt M / I, less what the yaw damping of the tyres takes back within the step.

    Tyres damp the yaw rate at L = m g (s_f C_f a^2 + s_r C_r b^2) / (I v), with s the axles' shares
    of the load and C their cornering stiffness over it: 40 /s at 4 m/s. A moment M leaves
    (1 + L dt / 2)^-1 of dt M / I. `measured_tyres` finds C of a simulator.
    """

    option_names = ("stiffness",)
    stiffness: tuple[float, float] = (0.0, 0.0)
    """C of front and rear axle [1/rad]; 0 for a simulator without tyres."""

    @abstractmethod
    def _moment_change(self, motion: Motion) -> Tensor:
        """Change [n] of the yaw rate by the moment alone."""

    def _change(self, motion: Motion) -> Tensor:
        d, (front, rear) = self.dimensions, self.stiffness
        a, b = d.cg_to_front_axle, d.cg_to_rear_axle
        # Load shares are b / L in front and a / L behind: m g s_f C_f a^2 = m g C_f a^2 b / L.
        damping = GRAVITY * d.mass / d.yaw_inertia * a * b * (front * a + rear * b) / d.wheelbase
        rate = damping / motion.after[..., 0].abs().clamp_min(SLOWEST)
        return turning(self._moment_change(motion) / (1 + 0.5 * self.dt * rate))


class OneSidedDrag(YawEffect):
    """Yaw moment of a wheel that drags on one side while the car moves.

    Its longitudinal force is left out: that is `rolling_resistance`.
    """

    name = "one_sided_drag"
    look_at = "Compare left and right: a dragging wheel, bearing, tyre diameter, toe."
    equation = "dr/dt = yaw_acceleration tanh(vx / 0.3 m/s)"
    source = (
        "Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., ch. 8 (yaw moment of unequal left "
        "and right longitudinal forces)"
    )
    declared = (
        EffectParameter(
            "yaw_acceleration", 0.0, -100.0, 100.0, "rad/s^2", "Positive to the left.", 8.0, 0.5
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        side = "left" if values["yaw_acceleration"] >= 0 else "right"
        rate = abs(math.degrees(values["yaw_acceleration"]))
        return (
            f"a wheel drags on the {side} and turns the car that way, {rate:.3g} degrees/s faster "
            "each second if nothing held it"
        )

    def _moment_change(self, motion: Motion) -> Tensor:
        rolling = torch.tanh(motion.after[..., 0] / ROLLING)
        return self._value("yaw_acceleration") * rolling * self.dt


class YawDamping(YawEffect):
    """Damping of the yaw rate; exact over a step: r' = r exp(-rate dt)."""

    name = "yaw_damping"
    look_at = "Check the differentials (locked, stiff) and the tyres: what resists turning?"
    equation = "dr/dt = -rate r"
    source = "Milliken & Milliken 1995, Race Car Vehicle Dynamics, ch. 5 (yaw damping derivative)"
    declared = (
        EffectParameter("rate", 0.0, -5.0, 100.0, "1/s", "Yaw deceleration over rate.", 5.0, 0.3),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = -100 * math.expm1(-0.1 * values["rate"])
        return f"turning dies out: {share:.3g} % of a spin is gone after a tenth of a second"

    def _moment_change(self, motion: Motion) -> Tensor:
        return motion.after[..., 2] * torch.expm1(-self._value("rate") * self.dt)
