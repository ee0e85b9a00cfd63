"""Resistances: 0 at rest, and within a step at most to a stop."""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect, along

TYPICAL_SPEED = 2.0  # [m/s] speed of the decelerations quoted in sentences; chosen
STOPPING = 0.05  # [m/s] speed at which dry friction is at tanh(1) = 76 %; chosen


def slowed(speed: Tensor, loss: Tensor) -> Tensor:
    """Change [n] of a speed [n] of either sign by a loss [n] >= 0 [m/s], at most to a stop."""
    return -torch.sign(speed) * torch.minimum(loss, speed.abs())


class AerodynamicDrag(MotionEffect):
    """Drag in proportion to the square of the speed.

    Over a step dv/dt = -c v^2 has the solution v' = v / (1 + c v dt).
    """

    name = "aerodynamic_drag"
    look_at = "Look at the body shell and the wing: another shape, a loose part."
    equation = "dv/dt = -coefficient |v| v"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 4 (aerodynamic drag)"
    declared = (
        EffectParameter(
            "coefficient", 0.0, -0.05, 2.0, "1/m", "Deceleration over speed squared.", 0.02, 0.01
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["coefficient"] * TYPICAL_SPEED**2
        return f"the air slows the car by {loss:.3g} m/s a second at {TYPICAL_SPEED:g} m/s"

    def _change(self, motion: Motion) -> Tensor:
        passed = self._value("coefficient") * motion.speed * self.dt
        share = -passed / (1 + passed).clamp_min(1e-3)
        return torch.cat([share.unsqueeze(-1) * motion.after[..., :2], _still(motion)], -1)


class RollingResistance(MotionEffect):
    """Dry friction of wheels and gear, multiplied by tanh(|vx| / 0.05 m/s)."""

    name = "rolling_resistance"
    look_at = "Push the car by hand: tyres, wheel bearings, gear mesh, the floor's surface."
    equation = "dvx/dt = -deceleration tanh(vx / 0.05 m/s)"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 4 (rolling resistance)"
    declared = (
        EffectParameter("deceleration", 0.0, -0.5, 5.0, "m/s^2", "Whatever the speed.", 0.2, 0.05),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the car rolls out {values['deceleration']:.3g} m/s a second faster at any speed"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        loss = self._value("deceleration") * torch.tanh(vx.abs() / STOPPING) * self.dt
        return along(slowed(vx, loss))


class ViscousDrag(MotionEffect):
    """Resistance in proportion to vx; exact over a step: vx' = vx exp(-rate dt)."""

    name = "viscous_drag"
    look_at = "Spin the drivetrain by hand: bearings, grease, gear mesh; and the drag brake."
    equation = "dvx/dt = -rate vx"
    source = "Armstrong-Helouvry, Dupont & Canudas de Wit 1994, Automatica 30(7) (viscous friction)"
    declared = (
        EffectParameter("rate", 0.0, -0.2, 5.0, "1/s", "Deceleration over speed.", 0.45, 0.02),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            f"something viscous takes {values['rate']:.3g} m/s a second from each m/s of the speed"
        )

    def _change(self, motion: Motion) -> Tensor:
        return along(motion.after[..., 0] * torch.expm1(-self._value("rate") * self.dt))


class CorneringDrag(MotionEffect):
    """Drag in turns, in proportion to the lateral acceleration vx yaw_rate."""

    name = "cornering_drag"
    look_at = "Check toe and differentials: what binds or scrubs in a turn?"
    equation = "dvx/dt = -coefficient |vx yaw_rate|"
    source = (
        "Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 1.3 (longitudinal part of the "
        "front side force in a turn)"
    )
    declared = (
        EffectParameter(
            "coefficient", 0.0, -0.3, 2.0, "-", "Deceleration over lateral one.", 0.1, 0.02
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = 5 * values["coefficient"]
        return f"turns slow the car: by {loss:.3g} m/s a second at half a g sideways"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        loss = self._value("coefficient") * (vx * motion.turn_rate).abs() * self.dt
        return along(slowed(vx, loss))


def _still(motion: Motion) -> Tensor:
    """[n, 1] zeros: the yaw rate is left alone."""
    return torch.zeros_like(motion.after[..., 2:])
