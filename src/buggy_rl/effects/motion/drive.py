"""A motor that gives less, or a car that is heavier, than simulated.

From outside only the sum of drive and resistance is seen. What the motor gives is that sum, plus
what the simulated car loses while it coasts, c0 tanh(vx / 0.1 m/s) + c1 vx, plus what its front
wheels, which push square to where they point, brake in a turn. `measuring` finds c0 and c1 for a
simulator, and by how much its motor loses with the speed.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter, one_in
from buggy_rl.effects.motion.base import LOCK, SETTING_OFF, Motion, MotionEffect, along
from buggy_rl.vehicle import VehicleDimensions

COASTING = (0.5, 0.25)  # [m/s^2], [1/s] of the buggy as the single-track preset has it
SPEED_LOSS = (0.6, 0.0)  # [1/s] of the reference car's motor, whatever the drive
ROLLING = 0.15  # [m/s^2] rubber on a hard floor, 0.015 of the load; chosen
SLOWEST = 0.2  # [m/s] below it a limit of power is one of force, and a turn is not sharper
UNLIMITED = 1000.0  # [W/kg] more than any such car has
DRIVING = 0.1  # [m/s^2] drive at which 76 % of the back-EMF is felt: none while it coasts
ASKED = 0.03  # drive from which on the motor is taken to work: none without throttle; chosen


class Payload(MotionEffect):
    """A load: what does not grow with it - motor, gear, air - moves more mass.

    Tyres grip, and rubber rolls, in proportion to their load: they turn and slow the car as before.

    Args:
        rolling: Deceleration of the simulated car that is in proportion to its load [m/s^2].
        dimensions, dt, values: As for the other motion effects.
    """

    name = "payload"
    equation = "(dvx/dt + rolling + braking of the turned wheels) / mass_ratio"
    declared = (
        EffectParameter("mass_ratio", 1.0, 0.5, 3.0, "-", "Mass over the simulated.", 0.2, 0.02),
    )

    def __init__(self, *, rolling: float = ROLLING, **rest: Any) -> None:
        self.rolling = float(rolling)
        super().__init__(**rest)

    @property
    def options(self) -> dict[str, Any]:
        return super().options | ({"rolling": self.rolling} if self.rolling != ROLLING else {})

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the car weighs {one_in(values['mass_ratio'])} than simulated"

    def _change(self, motion: Motion) -> Tensor:
        ax, _, _ = motion.acceleration
        grown = self.rolling * torch.tanh(motion.after[..., 0] / SETTING_OFF)
        moved = ax + grown + turning_drag(motion, self.dimensions)
        return along(self.dt * moved * (1 / self._here("mass_ratio").clamp_min(1e-2) - 1))


class MotorEffect(MotionEffect):
    """The motor's acceleration, as another motor would have made it.

    Args:
        coasting: c0 [m/s^2] and c1 [1/s] of what the simulated car loses without drive.
        dimensions, dt, values: As for the other motion effects.
    """

    def __init__(self, *, coasting: Sequence[float] = COASTING, **rest: Any) -> None:
        self.coasting = (float(coasting[0]), float(coasting[1]))
        super().__init__(**rest)

    @property
    def options(self) -> dict[str, Any]:
        changed = self.coasting != COASTING
        return super().options | ({"coasting": list(self.coasting)} if changed else {})

    def _drive(self, motion: Motion) -> Tensor:
        """What the motor gives [n] >= 0 [m/s^2]; nothing where nothing was asked of it."""
        ax, _, _ = motion.acceleration
        vx = 0.5 * (motion.before[..., 0] + motion.after[..., 0])
        loss = self.coasting[0] * torch.tanh(vx / SETTING_OFF) + self.coasting[1] * vx
        given = ax + loss + turning_drag(motion, self.dimensions)
        return given.clamp_min(0.0) * torch.tanh(motion.drive / ASKED)


class MotorPowerLimit(MotorEffect):
    """The motor's power has a limit: the faster, the less it pulls."""

    name = "motor_power_limit"
    equation = "drive acceleration <= power_per_mass / vx"
    declared = (
        EffectParameter(
            "power_per_mass",
            UNLIMITED,
            0.2,
            UNLIMITED,
            "W/kg",
            "Largest power of the motor over the mass.",
            size=8.0,
            probe=8.0 - UNLIMITED,
            reciprocal=True,
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the motor gives no more than {values['power_per_mass']:.3g} W a kilogram"

    def _change(self, motion: Motion) -> Tensor:
        drive = self._drive(motion)
        speed = motion.before[..., 0].abs().clamp_min(SLOWEST)
        limit = self._here("power_per_mass").clamp_min(0.0) / speed
        return along(self.dt * (torch.minimum(drive, limit) - drive))


class TopSpeed(MotorEffect):
    """A motor that turns slower: back-EMF takes the drive away earlier, from the same start.

    a' = a - b vx (1 / speed_ratio - 1), never below zero, and nothing while the car coasts, with
    b = b0 + b1 drive what the simulated motor loses with the speed: b0 of one that is given a
    voltage, b1 of one that is given a share of its force.

    Args:
        speed_loss: b0 and b1 [1/s].
        coasting, dimensions, dt, values: As for the other motion effects.
    """

    name = "top_speed"
    equation = "drive acceleration - speed_loss vx (1 / speed_ratio - 1)"
    declared = (
        EffectParameter(
            "speed_ratio", 1.0, 0.2, 3.0, "-", "No-load speed over the simulated.", 0.15, 0.02
        ),
    )

    def __init__(self, *, speed_loss: Sequence[float] = SPEED_LOSS, **rest: Any) -> None:
        self.speed_loss = (float(speed_loss[0]), float(speed_loss[1]))
        super().__init__(**rest)

    @property
    def options(self) -> dict[str, Any]:
        changed = self.speed_loss != SPEED_LOSS
        return super().options | ({"speed_loss": list(self.speed_loss)} if changed else {})

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ratio = values["speed_ratio"]
        faster = "faster" if ratio >= 1 else "slower"
        return f"the motor runs {100 * abs(ratio - 1):.3g} % {faster} before its voltage is used up"

    def _change(self, motion: Motion) -> Tensor:
        drive = self._drive(motion)
        lost = (self.speed_loss[0] + self.speed_loss[1] * motion.drive).clamp_min(0.0)
        slower = 1 / self._here("speed_ratio").clamp_min(1e-2) - 1
        loss = lost * motion.before[..., 0] * slower * torch.tanh(drive / DRIVING)
        return along(-self.dt * torch.minimum(loss, drive))


def turning_drag(motion: Motion, dimensions: VehicleDimensions) -> Tensor:
    """What the front wheels brake [n] [m/s^2]: F tan(delta), delta taken to be L r / vx."""
    d = dimensions
    _, ay, yaw = motion.acceleration
    front = (d.cg_to_rear_axle * ay + d.yaw_inertia / d.mass * yaw) / d.wheelbase
    speed = motion.after[..., 0].clamp_min(SLOWEST)
    angle = (d.wheelbase * motion.turn_rate / speed).clamp(-LOCK, LOCK)
    return front * torch.tan(angle)
