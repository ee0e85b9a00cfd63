"""Yaw moments, and the share of them that the tyres leave at the end of a step."""

from abc import abstractmethod
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import TYPICAL_STIFFNESS, Motion, MotionEffect, turning

SLOWEST = 0.5  # [m/s] speed below which the yaw damping of the tyres grows no further; chosen
BRISK_LENGTHS = 15.0  # [1/s] wheelbases a second at which tyre damping is quoted: 2.6 m/s; chosen
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
        speed = motion.after[..., 0].abs().clamp_min(SLOWEST)
        rate = tyre_damping(self.dimensions, self.stiffness) / speed
        return turning(self._moment_change(motion) / (1 + 0.5 * self.dt * rate))


def tyre_damping(d: VehicleDimensions, stiffness: tuple[float, float]) -> float:
    """L v [m/s^2] of the yaw damping L = m g (s_f C_f a^2 + s_r C_r b^2) / (I v) by the tyres."""
    a, b = d.cg_to_front_axle, d.cg_to_rear_axle
    # Load shares are b / L in front and a / L behind: m g s_f C_f a^2 = m g C_f a^2 b / L.
    front, rear = stiffness
    return GRAVITY * d.mass / d.yaw_inertia * a * b * (front * a + rear * b) / d.wheelbase


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
            "yaw_acceleration",
            0.0,
            -100.0,
            100.0,
            "rad/s^2",
            "Positive to the left.",
            size=8.0,
            probe=0.5,
            usual=(-15.0, 15.0),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        side, (force, _) = (
            _side(values["yaw_acceleration"]),
            cls._force(values, VehicleDimensions()),
        )
        return (
            f"a wheel drags on the {side} and pulls the car that way, by {force:.3g} N for each "
            "kilogram of a car of the buggy's shape and size"
        )

    @classmethod
    def said(
        cls,
        values: Mapping[str, float],
        car: VehicleDimensions,
        command: LongitudinalCommand = ONE_WAY,
    ) -> str:
        del command
        side, (_, force) = _side(values["yaw_acceleration"]), cls._force(values, car)
        return (
            f"a wheel drags on the {side} and pulls the car that way, by {force:.3g} N at the "
            f"wheel of a car of {car.mass:.3g} kg"
        )

    @classmethod
    def _force(cls, values: Mapping[str, float], car: VehicleDimensions) -> tuple[float, float]:
        """Force of the wheel, over the car's mass [N/kg] and as it is [N]: I dr/dt = F t / 2."""
        moment = car.yaw_inertia * abs(values["yaw_acceleration"])
        force = moment / (0.5 * car.track_width)
        return force / car.mass, force

    def _moment_change(self, motion: Motion) -> Tensor:
        rolling = torch.tanh(motion.after[..., 0] / ROLLING)
        return self._value("yaw_acceleration") * rolling * self.dt


class YawDamping(YawEffect):
    """Damping of the yaw rate beyond the tyres' own; exact over a step: r' = r exp(-rate dt).

    It says how the car behaves, not why: a locked or stiff differential, tyres that scrub or take
    time to build up their force, a steering that gives way, or a yaw inertia that is too small
    in the simulator look like it.
    """

    name = "yaw_damping"
    look_at = "Check the differentials (locked, stiff) and the tyres: what resists turning?"
    equation = "dr/dt = -rate r"
    source = "Milliken & Milliken 1995, Race Car Vehicle Dynamics, ch. 5 (yaw damping derivative)"
    declared = (
        EffectParameter(
            "rate",
            0.0,
            -5.0,
            100.0,
            "1/s",
            "Yaw deceleration over rate.",
            size=5.0,
            probe=0.3,
            usual=(0.0, 15.0),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return cls.said(values, VehicleDimensions())

    @classmethod
    def said(
        cls,
        values: Mapping[str, float],
        car: VehicleDimensions,
        command: LongitudinalCommand = ONE_WAY,
    ) -> str:
        del command
        own = tyre_damping(car, TYPICAL_STIFFNESS) / (BRISK_LENGTHS * car.wheelbase)
        share = 100 * values["rate"] / own
        return (
            f"the car behaves like one whose turning is damped {abs(share):.2g} % "
            f"{'more' if share >= 0 else 'less'} than by its tyres alone, as by a stiff "
            "differential, scrubbing tyres, a steering that gives way or a larger yaw inertia"
        )

    def _moment_change(self, motion: Motion) -> Tensor:
        return motion.after[..., 2] * torch.expm1(-self._value("rate") * self.dt)


def _side(value: float) -> str:
    return "left" if value >= 0 else "right"
