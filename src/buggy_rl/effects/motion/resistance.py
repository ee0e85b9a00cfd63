"""What slows the car down: it vanishes at rest and never turns a motion round."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect, along

TYPICAL_SPEED = 2.0  # [m/s] at which the sentences quote a deceleration
STOPPING = 0.05  # [m/s] dry friction comes up to 76 % at this speed; chosen


def slowed(speed: Tensor, loss: Tensor) -> Tensor:
    """Change [n] of a speed [n] of either sign by a loss [n] >= 0, at most to a stop."""
    return -torch.sign(speed) * torch.minimum(loss, speed.abs())


class AerodynamicDrag(MotionEffect):
    """Drag with the square of the speed, against the motion.

    Over a step dv/dt = -c v^2 has the solution v' = v / (1 + c v dt).
    """

    name = "aerodynamic_drag"
    equation = "dv/dt = -coefficient |v| v"
    declared = (
        EffectParameter(
            "coefficient", 0.0, -0.05, 2.0, "1/m", "Deceleration over speed squared.", 0.08, 0.01
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["coefficient"] * TYPICAL_SPEED**2
        return f"the air slows the car by {loss:.3g} m/s a second at {TYPICAL_SPEED:g} m/s"

    def _change(self, motion: Motion) -> Tensor:
        passed = self._here("coefficient") * motion.speed * self.dt
        share = -passed / (1 + passed).clamp_min(1e-3)
        return torch.cat([share.unsqueeze(-1) * motion.after[..., :2], _still(motion)], -1)


class RollingResistance(MotionEffect):
    """Dry friction of wheels and gear, against the rolling.

    It comes up with tanh(|vx| / 0.05 m/s), so a standing car feels none.
    """

    name = "rolling_resistance"
    equation = "dvx/dt = -deceleration tanh(vx / 0.05 m/s)"
    declared = (
        EffectParameter("deceleration", 0.0, -0.5, 5.0, "m/s^2", "Whatever the speed.", 0.3, 0.05),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the car rolls out {values['deceleration']:.3g} m/s a second faster at any speed"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        loss = self._here("deceleration") * torch.tanh(vx.abs() / STOPPING) * self.dt
        return along(slowed(vx, loss))


class ViscousDrag(MotionEffect):
    """Resistance with the speed of the rolling; exact over a step: vx' = vx exp(-rate dt)."""

    name = "viscous_drag"
    equation = "dvx/dt = -rate vx"
    declared = (
        EffectParameter("rate", 0.0, -0.2, 5.0, "1/s", "Deceleration over speed.", 0.2, 0.02),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            f"something viscous takes {values['rate']:.3g} m/s a second from each m/s of the speed"
        )

    def _change(self, motion: Motion) -> Tensor:
        return along(motion.after[..., 0] * torch.expm1(-self._here("rate") * self.dt))


class CorneringDrag(MotionEffect):
    """Extra drag in turns, in proportion to the lateral acceleration that turns the car.

    It grows with steering and speed alike; the speed squared over the radius is what matters.
    """

    name = "cornering_drag"
    equation = "dvx/dt = -coefficient |vx yaw_rate|"
    declared = (
        EffectParameter(
            "coefficient", 0.0, -0.3, 2.0, "-", "Deceleration over lateral one.", 0.15, 0.02
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = 5 * values["coefficient"]
        return f"turns slow the car: by {loss:.3g} m/s a second at half a g sideways"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        loss = self._here("coefficient") * (vx * motion.turn_rate).abs() * self.dt
        return along(slowed(vx, loss))


def _still(motion: Motion) -> Tensor:
    """[n, 1] zeros: the yaw rate is left alone."""
    return torch.zeros_like(motion.after[..., 2:])
