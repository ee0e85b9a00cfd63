"""Understeer by compliance, softer tyres, and steering by the pitch of the body."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.effects.base import EffectParameter, more_or_less
from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.tyre.base import TyreEffect
from buggy_rl.effects.tyre.change import FrictionChange, changed_by
from buggy_rl.effects.tyre.law import law, slope

STEPS = 3  # of Newton's method: 4 change a side force by under 0.1 % at the bounds
STEEPEST = 0.2  # [-] least derivative of the equation: a wheel that snaps round has none; chosen


@dataclass(frozen=True)
class SlipChange(FrictionChange):
    """What other slip angles change; `ratio` [4, n] is q front and rear, k and `steer`."""

    kernel: ClassVar[str] = "slip_change"
    rows: ClassVar[int] = 4

    def _grip(self, ratio: Tensor) -> Tensor:
        return torch.ones_like(ratio[:2])

    def _slip_now(self, slip: Tensor, ratio: Tensor, load: Tensor) -> tuple[Tensor, Tensor]:
        q, (compliance, steer) = ratio[:2], ratio[2:].unbind()
        front, c = torch.stack([torch.ones_like(steer), torch.zeros_like(steer)]), self.shape
        turned = front * steer * (self.stiffness / (c * self.friction))
        gives = front * compliance * q * self.stiffness * load / (self.share * c)  # k' (2, n)
        wanted = q * (slip + turned)
        now = wanted / (1 + c * gives).clamp_min(STEEPEST)
        for _ in range(STEPS):
            steep = (1 + c * gives * slope(now, c)).clamp_min(STEEPEST)
            now = now - (now + gives * law(now, c) - wanted) / steep
        least = slope(now, c)
        return now, q * least / (1 + c * gives * least).clamp_min(STEEPEST)


REAR_DRIVEN = changed_by((1, 2), kind=SlipChange)
ALL_DRIVEN = changed_by((0, 2), kind=SlipChange)
FRONT_DRIVEN = changed_by((0, 1), kind=SlipChange)
REAR_DRIVEN_TWO_WAY = changed_by((1, 2), two_way=True, kind=SlipChange)
ALL_DRIVEN_TWO_WAY = changed_by((0, 2), two_way=True, kind=SlipChange)
FRONT_DRIVEN_TWO_WAY = changed_by((0, 1), two_way=True, kind=SlipChange)


PULL = 3.0  # [m/s^2] acceleration of the angles quoted in a sentence; chosen


class Understeer(TyreEffect):
    """Front wheels that turn back under side force, beyond what the simulator has.

    delta' = delta - gradient F_yf / m_f, with m_f the front axle's share of the mass: in a steady
    turn F_yf / m_f is the lateral acceleration, and `gradient` is what is added to the understeer
    gradient. A steering that gives way (servo saver, rods, softer mounts), roll steer, and front
    tyres of less cornering stiffness are this one function of the side force.
    """

    name = "understeer"
    look_at = (
        "Press the front wheels sideways: servo saver and linkage; check front tyres, inserts, toe."
    )
    equation = "delta' = delta - gradient F_yf / m_f, at the same friction"
    source = (
        "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 6 (understeer gradient); Milliken & "
        "Milliken 1995, Race Car Vehicle Dynamics, ch. 23 (compliances)"
    )
    changes = SlipChange
    declared = (
        EffectParameter(
            "gradient",
            0.0,
            -0.008,
            0.1,
            "rad s^2/m",
            "Steering angle lost over lateral acceleration.",
            size=0.006,
            probe=0.001,
            usual=(-0.004, 0.015),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        degrees = math.degrees(values["gradient"]) * GRAVITY
        under = "under" if degrees >= 0 else "over"
        return (
            f"the car {under}steers by {abs(degrees):.3g} degrees of front-wheel angle per g more "
            "than simulated, as by a steering that gives way, roll steer, or "
            f"{'softer' if degrees >= 0 else 'stiffer'} front tyres"
        )

    def _ratios(self, motion: Motion) -> tuple[Tensor, ...]:
        gradient = self._value("gradient")
        one = torch.ones_like(gradient)
        return one, one, gradient, torch.zeros_like(gradient)


class CorneringStiffness(TyreEffect):
    """Another cornering stiffness of both axles, at the same friction: softer or harder tyres.

    Unlike `understeer`, which bends the path of a turn, it changes the car's sideslip angle in it
    and how fast the car answers.
    """

    name = "cornering_stiffness"
    look_at = "Check tyre compound, inserts and pressure, and load on the axles."
    equation = "C_f' = ratio C_f, C_r' = ratio C_r, at the same friction"
    source = "Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., sec. 2.3 (cornering stiffness)"
    changes = SlipChange
    declared = (
        EffectParameter(
            "ratio",
            1.0,
            0.1,
            5.0,
            "-",
            "Cornering stiffness over the simulated.",
            size=0.3,
            probe=-0.03,
            usual=(0.5, 1.6),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ratio = values["ratio"]
        return (
            f"the tyres give {more_or_less(ratio)} side force for a slip angle than simulated, "
            f"and slide as early: {'harder' if ratio >= 1 else 'softer'} tyres or inserts, or "
            f"{'more' if ratio >= 1 else 'less'} pressure"
        )

    def _ratios(self, motion: Motion) -> tuple[Tensor, ...]:
        ratio = self._value("ratio").clamp_min(1e-2)
        return ratio, ratio, torch.zeros_like(ratio), torch.zeros_like(ratio)


class DiveSteer(TyreEffect):
    """Bump steer of a car that dives and squats: front wheels that turn with its acceleration.

    delta' = delta + angle ax: a linkage of unequal sides turns both wheels the same way when the
    body pitches, so the car pulls to one side under throttle and to the other when it slows down.
    """

    name = "dive_steer"
    look_at = (
        "Press the car down at the front: do the wheels turn? Check the length of the tie rods."
    )
    equation = "delta' = delta + angle ax"
    source = (
        "Milliken & Milliken 1995, Race Car Vehicle Dynamics, ch. 19 (steering systems: ride and "
        "bump steer)"
    )
    changes = SlipChange
    declared = (
        EffectParameter(
            "angle",
            0.0,
            -0.1,
            0.1,
            "rad s^2/m",
            "Steering to the left over forward acceleration.",
            size=0.006,
            probe=0.001,
            usual=(-0.012, 0.012),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        degrees = math.degrees(PULL * values["angle"])
        side, other = ("left", "right") if degrees >= 0 else ("right", "left")
        return (
            f"the front wheels turn by {abs(degrees):.3g} degrees to the {side} while the car "
            f"gains {PULL:g} m/s a second, and to the {other} while it slows down: bump steer"
        )

    def _ratios(self, motion: Motion) -> tuple[Tensor, ...]:
        ax, _, _ = motion.acceleration
        steer = self._value("angle") * torch.where(motion.after[..., 0] < 0, -ax, ax)
        one = torch.ones_like(steer)
        return one, one, torch.zeros_like(steer), steer
