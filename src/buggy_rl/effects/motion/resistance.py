"""Resistances: 0 at rest, and within a step at most to a stop."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import LOCK, TYPICAL_STIFFNESS, Motion, MotionEffect, along
from buggy_rl.effects.motion.steered import FrontAxle, left_by_tyres, steered_angle

TYPICAL_SPEED = 2.0  # [m/s] speed of the decelerations quoted in sentences; chosen
BRISK = 5.0  # [m/s^2] lateral acceleration of those in turns; chosen
TURNED = 15.0  # [deg] road-wheel angle of those by turned wheels; chosen
STOPPING = 0.05  # [m/s] speed at which less friction than simulated is at tanh(1); chosen


def slowed(speed: Tensor, loss: Tensor) -> Tensor:
    """Change [n] of a speed [n] of either sign by a loss [n] [m/s], at most to a stop.

    Friction holds a car that stands: a part of it that faded with the speed would let it creep. A
    loss below 0 does, or the car would set off by itself.
    """
    more, less = loss.clamp_min(0.0), loss.clamp_max(0.0) * torch.tanh(speed.abs() / STOPPING)
    return -torch.sign(speed) * (torch.minimum(more, speed.abs()) + less)


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
            "coefficient",
            0.0,
            -0.05,
            2.0,
            "1/m",
            "Deceleration over speed squared.",
            0.02,
            0.01,
            usual=(0.0, 0.05),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["coefficient"] * TYPICAL_SPEED**2
        return (
            f"the air slows the car by {abs(loss):.3g} m/s a second{_less(loss)} at "
            f"{TYPICAL_SPEED:g} m/s"
        )

    def _change(self, motion: Motion) -> Tensor:
        passed = self._value("coefficient") * motion.speed * self.dt
        share = -passed / (1 + passed).clamp_min(1e-3)
        return torch.cat([share.unsqueeze(-1) * motion.after[..., :2], _still(motion)], -1)


class RollingResistance(MotionEffect):
    """Dry friction of wheels and gear."""

    name = "rolling_resistance"
    look_at = "Push the car by hand: tyres, wheel bearings, gear mesh, the floor's surface."
    equation = "dvx/dt = -deceleration sign(vx), at most to a stop"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 4 (rolling resistance)"
    declared = (
        EffectParameter(
            "deceleration",
            0.0,
            -0.5,
            5.0,
            "m/s^2",
            "Whatever the speed.",
            0.2,
            0.05,
            usual=(0.0, 0.7),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["deceleration"]
        how = "faster" if loss >= 0 else "slower"
        return f"the car rolls out {abs(loss):.3g} m/s a second {how} at any speed"

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        return along(slowed(vx, self._value("deceleration") * self.dt))


class ViscousDrag(MotionEffect):
    """Resistance in proportion to vx; exact over a step: vx' = vx exp(-rate dt)."""

    name = "viscous_drag"
    look_at = "Spin the drivetrain by hand: bearings, grease, gear mesh; and the drag brake."
    equation = "dvx/dt = -rate vx"
    source = "Armstrong-Helouvry, Dupont & Canudas de Wit 1994, Automatica 30(7) (viscous friction)"
    declared = (
        EffectParameter(
            "rate",
            0.0,
            -0.2,
            5.0,
            "1/s",
            "Deceleration over speed.",
            size=0.45,
            probe=0.02,
            usual=(0.0, 1.0),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            f"{_stiff_grease(values)} {abs(values['rate']):.3g} N for each m/s and each kilogram "
            "of the car"
        )

    @classmethod
    def said(
        cls,
        values: Mapping[str, float],
        car: VehicleDimensions,
        command: LongitudinalCommand = ONE_WAY,
    ) -> str:
        del command
        return (
            f"{_stiff_grease(values)} {abs(values['rate']) * car.mass:.3g} N s/m at a car of "
            f"{car.mass:.3g} kg"
        )

    def _change(self, motion: Motion) -> Tensor:
        return along(motion.after[..., 0] * torch.expm1(-self._value("rate") * self.dt))


class CorneringDrag(MotionEffect):
    """Induced drag of the tyres, beyond the simulated one.

    A tyre at a slip angle alpha pulls back by F_y sin(alpha). With alpha = F_y / (C N) both axles
    together take ay^2 / (C g) of the car: 0.014 s^2/m by the stiffnesses of DART's. A simulator
    with tyres has its own; the coefficient is what the car's softer tyres add. ay is vx yaw_rate.
    """

    name = "cornering_drag"
    look_at = "Check toe and differentials: what binds or scrubs in a turn?"
    equation = "dvx/dt = -coefficient (vx yaw_rate)^2"
    source = (
        "Milliken & Milliken 1995, Race Car Vehicle Dynamics, ch. 2 (induced drag of a tyre, side "
        "force times slip angle)"
    )
    declared = (
        EffectParameter(
            "coefficient",
            0.0,
            -0.03,
            0.3,
            "s^2/m",
            "Deceleration over the square of the lateral acceleration.",
            size=0.015,
            probe=0.003,
            usual=(0.0, 0.05),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["coefficient"] * BRISK**2
        return (
            f"the tyres' slip in turns slows the car{_less(loss)}: by {abs(loss):.3g} m/s a second "
            "at half a g sideways, a quarter of it at a quarter of a g"
        )

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        loss = self._value("coefficient") * (vx * motion.turn_rate).square() * self.dt
        return along(slowed(vx, loss))


class SteeringDrag(MotionEffect):
    """Drag of turned front wheels whatever the speed: scrub, no Ackermann, loaded joints.

    It acts at the front axle, along its wheels: so it has a part across the car, most of which the
    tyres take back. The road-wheel angle is read off the motion, see `steered_angle`. DART, the
    one published small car with such a term, loses 3.94 + 1.34 v N/rad on 1.58 kg: 3.4 m/s^2 a
    radian at 1 m/s.
    """

    name = "steering_drag"
    look_at = (
        "Turn the front wheels and push the car by hand: joints, Ackermann angle, tyres that scrub."
    )
    equation = "drag at the front wheels: dv/dt = -per_angle |delta| sign(vx), at most to a stop"
    source = (
        "Lyons et al. 2024, DART, dynamic model (friction due to steering, a + b v over the angle)"
    )
    declared = (
        EffectParameter(
            "per_angle",
            0.0,
            -1.0,
            30.0,
            "m/(s^2 rad)",
            "Deceleration over the road-wheel angle.",
            size=2.5,
            probe=0.3,
            usual=(0.0, 5.0),
        ),
    )
    option_names = ("stiffness", "friction", "shape", "lock")
    stiffness: tuple[float, float] = TYPICAL_STIFFNESS
    """C of the simulator's front and rear axle [1/rad]; 0 for a simulator without tyres."""
    friction: tuple[float, float] = (0.84, 0.84)
    """D of its axles; DART."""
    shape: tuple[float, float] = (1.2, 1.2)
    """c of its axles; chosen."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        loss = values["per_angle"] * math.radians(TURNED)
        return (
            f"turned front wheels slow the car{_less(loss)}: by {abs(loss):.3g} m/s a second at "
            f"{TURNED:g} degrees, at any speed"
        )

    def _change(self, motion: Motion) -> Tensor:
        vx = motion.after[..., 0]
        axle = FrontAxle(self.stiffness[0], self.friction[0], self.shape[0], self.lock)
        angle = steered_angle(motion, self.dimensions, axle)
        loss = self._value("per_angle") * angle.abs() * self.dt
        d, pulled = self.dimensions, slowed(vx, loss)  # (n,) along the front wheels
        across = pulled * torch.sin(angle)
        front, rear = left_by_tyres(motion, d, self.stiffness, across, torch.zeros_like(across))
        moment = d.cg_to_front_axle * front - d.cg_to_rear_axle * rear
        yaw = d.mass / d.yaw_inertia * moment
        return torch.stack([pulled * torch.cos(angle), front + rear, yaw], -1)


def _still(motion: Motion) -> Tensor:
    """[n, 1] zeros: the yaw rate is left alone."""
    return torch.zeros_like(motion.after[..., 2:])


def _less(loss: float) -> str:
    """The word for a drag that is smaller than the simulator's."""
    return "" if loss >= 0 else " less"


def _stiff_grease(values: Mapping[str, float]) -> str:
    if values["rate"] >= 0:
        return "a drag that grows with the speed, as of stiff grease:"
    return "less of a drag that grows with the speed, as of bearings that have run in:"
