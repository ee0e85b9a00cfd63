"""Moments about the vertical, and how much of them the tyres let through within a step."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect, turning
from buggy_rl.vehicle import GRAVITY

SLOWEST = 0.5  # [m/s] below it tyres straighten a car out no faster
ROLLING = 0.3  # [m/s] a wheel drags with 76 % of its force at this speed; chosen


class YawEffect(MotionEffect):
    """dr = dt M / I, less what tyres take back before the step is over.

    Tyres straighten a car out at the rate L = m g (s_f C_f a^2 + s_r C_r b^2) / (I v), with s the
    axles' shares of the load and C their stiffness over it: 40 /s at 4 m/s. So what a moment leaves
    at the end of a step is (1 + L dt / 2)^-1 of it. `measured_tyres` finds C for a simulator.

    Args:
        stiffness: C of front and rear [1/rad]; none for a simulator without tyres.
        dimensions, dt, values: As for the other motion effects.
    """

    def __init__(self, *, stiffness: Sequence[float] = (0.0, 0.0), **rest: Any) -> None:
        self.stiffness = (float(stiffness[0]), float(stiffness[1]))
        super().__init__(**rest)

    @property
    def options(self) -> dict[str, Any]:
        return super().options | ({"stiffness": [*self.stiffness]} if any(self.stiffness) else {})

    @abstractmethod
    def _gained(self, motion: Motion) -> Tensor:
        """Change [n] of the yaw rate by the moment alone."""

    def _change(self, motion: Motion) -> Tensor:
        d, (front, rear) = self.dimensions, self.stiffness
        a, b = d.cg_to_front_axle, d.cg_to_rear_axle
        # Shares of the load are b / L in front and a / L behind.
        back = GRAVITY * d.mass / d.yaw_inertia * a * b * (front * a + rear * b) / d.wheelbase
        rate = back / motion.after[..., 0].abs().clamp_min(SLOWEST)
        return turning(self._gained(motion) / (1 + 0.5 * self.dt * rate))


class OneSidedDrag(YawEffect):
    """A wheel on one side that drags, and turns the car as long as it moves.

    What it takes from the speed is left out: that is `rolling_resistance`.
    """

    name = "one_sided_drag"
    equation = "dr/dt = yaw_acceleration tanh(vx / 0.3 m/s)"
    declared = (
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

    def _gained(self, motion: Motion) -> Tensor:
        rolling = torch.tanh(motion.after[..., 0] / ROLLING)
        return self._here("yaw_acceleration") * rolling * self.dt


class YawDamping(YawEffect):
    """Turning is resisted; over a step, r' = r exp(-rate dt)."""

    name = "yaw_damping"
    equation = "dr/dt = -rate r"
    declared = (
        EffectParameter("rate", 0.0, -5.0, 100.0, "1/s", "Yaw deceleration over rate.", 3.0, 0.3),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = -100 * math.expm1(-0.1 * values["rate"])
        return f"turning dies out: {share:.3g} % of a spin is gone after a tenth of a second"

    def _gained(self, motion: Motion) -> Tensor:
        return motion.after[..., 2] * torch.expm1(-self._here("rate") * self.dt)
