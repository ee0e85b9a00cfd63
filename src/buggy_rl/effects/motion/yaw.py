"""Moments about the vertical."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect, turning

ROLLING = 0.3  # [m/s] a wheel drags with 76 % of its force at this speed; chosen


class OneSidedDrag(MotionEffect):
    """A wheel on one side that drags, and turns the car as long as it moves.

    What it takes from the speed is left out: that is `rolling_resistance`.
    """

    name = "one_sided_drag"
    equation = "dr/dt = yaw_acceleration tanh(vx / 0.3 m/s)"
    parameters = (
        EffectParameter(
            "yaw_acceleration", 0.0, -100.0, 100.0, "rad/s^2", "Positive to the left.", 5.0, 0.5
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

    def _change(self, motion: Motion) -> Tensor:
        rolling = torch.tanh(motion.after[..., 0] / ROLLING)
        return turning(self._here("yaw_acceleration") * rolling * self.dt)


class YawDamping(MotionEffect):
    """Turning is resisted; exact over a step: r' = r exp(-rate dt)."""

    name = "yaw_damping"
    equation = "dr/dt = -rate r"
    parameters = (
        EffectParameter("rate", 0.0, -5.0, 100.0, "1/s", "Yaw deceleration over rate.", 3.0, 0.3),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = -100 * math.expm1(-0.1 * values["rate"])
        return f"turning dies out: {share:.3g} % of a spin is gone after a tenth of a second"

    def _change(self, motion: Motion) -> Tensor:
        return turning(motion.after[..., 2] * torch.expm1(-self._here("rate") * self.dt))
