"""A motor with less force, or a car with more mass, than simulated.

The acceleration of a black box is the sum of motor, resistance and tyres. The motor's part is that
sum, plus the deceleration of the simulated car while it coasts, c0 tanh(vx / 0.1 m/s) + c1 vx, plus
the longitudinal part of the side force of its turned front wheels. `measuring` finds c0 and c1 of a
simulator, and the decrease of its motor force with the speed.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.effects.base import EffectParameter, more_or_less
from buggy_rl.effects.motion.base import LOCK, SETTING_OFF, Motion, MotionEffect, along

ROLLING = 0.15  # [m/s^2] rolling resistance of rubber on a hard floor, 0.015 of the load; chosen
SLOWEST = (
    0.2  # [m/s] speed below which a power limit is a force limit, and an arc no tighter; chosen
)
UNLIMITED = 1000.0  # [W/kg] neutral power limit; tyres pass 0.84 g x 10 m/s = 82 W/kg
SPEED_LOSS = (0.6, 0.0)  # [1/s] b0 and b1 of the reference car's motor
DRIVING = 0.1  # [m/s^2] motor acceleration at which back-EMF is at tanh(1) = 76 %; chosen
ASKED = 0.03  # [-] drive command at which the motor is at tanh(1) = 76 % of its force; chosen


class Payload(MotionEffect):
    """More mass behind the forces that do not grow with the load: motor, gear and air.

    Tyre forces and rolling resistance are in proportion to the load: their accelerations stay.
    """

    name = "payload"
    look_at = "Weigh the car with all that it carries."
    equation = "(dvx/dt + rolling + braking of the turned wheels) / mass_ratio"
    source = "Rajamani 2012, Vehicle Dynamics and Control, 2nd ed., eq. (4.1)"
    declared = (
        EffectParameter(
            "mass_ratio",
            1.0,
            0.5,
            3.0,
            "-",
            "Mass over the simulated.",
            0.25,
            0.02,
            usual=(0.8, 1.6),
        ),
    )
    option_names = ("rolling", "lock")
    rolling: float = ROLLING
    """Deceleration of the simulated car that is in proportion to its load [m/s^2]."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the car weighs {more_or_less(values['mass_ratio'])} than simulated"

    def _change(self, motion: Motion) -> Tensor:
        ax, _, _ = motion.acceleration
        grown = self.rolling * torch.tanh(motion.after[..., 0] / SETTING_OFF)
        moved = ax + grown + turning_drag(motion, self.dimensions, self.lock)
        return along(self.dt * moved * (1 / self._value("mass_ratio").clamp_min(1e-2) - 1))


class MotorEffect(MotionEffect):
    """The motor's acceleration, replaced by that of another motor."""

    option_names = ("coasting", "lock")
    coasting: tuple[float, float] = (0.5, 0.25)
    """c0 [m/s^2] and c1 [1/s] of the coasting simulated car; those of the single-track buggy."""
    lock: float = LOCK
    """Largest road-wheel angle [rad]."""

    def _drive(self, motion: Motion) -> Tensor:
        """Acceleration [n] >= 0 [m/s^2] by the motor; 0 without a drive command."""
        return drive_of_motor(motion, self.dimensions, self.coasting, self.lock)


class MotorPowerLimit(MotorEffect):
    """Limit of the motor's power: force at most power / speed."""

    name = "motor_power_limit"
    look_at = (
        "Check the controller's current limit, the battery's discharge rating and the motor's heat."
    )
    equation = "drive acceleration <= power_per_mass / vx"
    source = "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 2 (power-limited acceleration)"
    declared = (
        EffectParameter(
            "power_per_mass",
            UNLIMITED,
            0.2,
            UNLIMITED,
            "W/kg",
            "Largest power of the motor over the mass.",
            size=15.0,
            probe=8.0 - UNLIMITED,
            reciprocal=True,
            usual=(2.0, 40.0),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the motor gives no more than {values['power_per_mass']:.3g} W a kilogram"

    def _change(self, motion: Motion) -> Tensor:
        drive = self._drive(motion)
        speed = motion.before[..., 0].abs().clamp_min(SLOWEST)
        limit = self._value("power_per_mass").clamp_min(0.0) / speed
        return along(self.dt * (torch.minimum(drive, limit) - drive))


class TopSpeed(MotorEffect):
    """Another no-load speed of the motor: back-EMF reduces its force earlier, from the same stall.

    So it is with fewer turns of a thicker wire. Another gear moves the stall force too:
    `gear_ratio`.

    a' = a - b vx (1 / speed_ratio - 1), not below 0, and a' = a while the car coasts, with
    b = b0 + b1 drive the decrease of the simulated motor's acceleration with the speed: b0 of a
    motor whose command is a voltage, b1 of one whose command is a share of its force.
    """

    name = "top_speed"
    look_at = "Check the battery's cells and voltage, the motor's kV and the gearing."
    equation = "drive acceleration - speed_loss vx (1 / speed_ratio - 1)"
    source = (
        "Franklin, Powell & Emami-Naeini 2010, Feedback Control of Dynamic Systems, 6th ed., "
        "sec. 2.3 (back-EMF of a DC motor)"
    )
    declared = (
        EffectParameter(
            "speed_ratio",
            1.0,
            0.2,
            3.0,
            "-",
            "No-load speed over the simulated.",
            size=0.3,
            probe=0.02,
            usual=(0.5, 1.7),
        ),
    )
    option_names = ("coasting", "lock", "speed_loss")
    speed_loss: tuple[float, float] = SPEED_LOSS
    """b0 and b1 [1/s]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ratio = values["speed_ratio"]
        faster = "faster" if ratio >= 1 else "slower"
        return f"the motor runs {100 * abs(ratio - 1):.3g} % {faster} before its voltage is used up"

    def _change(self, motion: Motion) -> Tensor:
        drive = self._drive(motion)
        lost = (self.speed_loss[0] + self.speed_loss[1] * motion.drive).clamp_min(0.0)
        slower = 1 / self._value("speed_ratio").clamp_min(1e-2) - 1
        loss = lost * motion.before[..., 0] * slower * torch.tanh(drive / DRIVING)
        return along(-self.dt * torch.minimum(loss, drive))


class GearRatio(MotorEffect):
    """Another gear, pinion or wheel diameter: stall force times g, no-load speed over g.

    F' = g F(g v): with F falling by b v, a' = a + (g - 1) F - g (g - 1) b v, with b as in
    `TopSpeed`, and the motor's part not below 0.
    """

    name = "gear_ratio"
    look_at = "Count the teeth of pinion and spur gear; measure the wheels' diameter."
    equation = "drive acceleration' (v) = ratio drive acceleration (ratio v)"
    source = (
        "Gillespie 1992, Fundamentals of Vehicle Dynamics, ch. 2 (tractive force and speed through "
        "a gear)"
    )
    declared = (
        EffectParameter(
            "ratio",
            1.0,
            0.3,
            3.0,
            "-",
            "Turns of the motor for one of the wheels, over the simulated.",
            size=0.15,
            probe=0.02,
            usual=(0.7, 1.4),
        ),
    )
    option_names = ("coasting", "lock", "speed_loss")
    speed_loss: tuple[float, float] = SPEED_LOSS
    """b0 and b1 [1/s]."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        ratio = values["ratio"]
        gear = "shorter" if ratio >= 1 else "longer"
        return (
            f"the gear is {gear}: the motor pulls {more_or_less(ratio)} from standing and reaches "
            f"{more_or_less(1 / ratio)} speed"
        )

    def _change(self, motion: Motion) -> Tensor:
        drive, ratio = self._drive(motion), self._value("ratio").clamp_min(1e-2)
        lost = (self.speed_loss[0] + self.speed_loss[1] * motion.drive).clamp_min(0.0)
        loss = ratio * lost * motion.before[..., 0] * torch.tanh(drive / DRIVING)
        return along(self.dt * torch.maximum((ratio - 1) * (drive - loss), -drive))


class VoltageSag(MotorEffect):
    """The supply's voltage drops under load: a further resistance in battery, plug or wires.

    A controller at duty cycle d draws d i from the battery for a motor current i, so with R in the
    supply and R_m in motor and controller i = (d V - k u) / (R_m + d^2 R): the force falls by
    1 / (1 + d^2 R / R_m) at any speed. Weakening over time is `battery_sag`.
    """

    name = "voltage_sag"
    look_at = "Measure the battery's voltage under full throttle: pack, plug, wires."
    equation = "drive acceleration / (1 + resistance_ratio duty^2)"
    source = (
        "Linden & Reddy 2002, Handbook of Batteries, 3rd ed., ch. 3 (ohmic polarisation), through "
        "a speed controller that conserves power"
    )
    declared = (
        EffectParameter(
            "resistance_ratio",
            0.0,
            -0.3,
            3.0,
            "-",
            "Resistance that the supply has more than simulated, over that of the motor.",
            size=0.25,
            probe=0.05,
            usual=(0.0, 0.8),
        ),
    )
    option_names = ("coasting", "lock", "onset")
    onset: float = 0.0
    """Drive in 0..1 at which the simulated motor begins to give force."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lost = 100 * (1 - 1 / (1 + values["resistance_ratio"]))
        word = "drops" if lost >= 0 else "holds"
        less = "less" if lost >= 0 else "more"
        return (
            f"the battery's voltage {word} under load: at full throttle the motor pulls "
            f"{abs(lost):.3g} % {less}, at half throttle a quarter of that"
        )

    def _change(self, motion: Motion) -> Tensor:
        duty = ((motion.drive - self.onset) / (1 - self.onset)).clamp(0.0, 1.0)
        sag = (self._value("resistance_ratio") * duty.square()).clamp_min(-0.9)
        return along(-self.dt * self._drive(motion) * sag / (1 + sag))


def drive_of_motor(
    motion: Motion, dimensions: VehicleDimensions, coasting: tuple[float, float], lock: float = LOCK
) -> Tensor:
    """Acceleration [n] >= 0 [m/s^2] by the motor of a car; 0 without a drive command.

    Args:
        motion: Of n environments.
        dimensions: Of the car.
        coasting: c0 [m/s^2] and c1 [1/s] of the coasting simulated car.
        lock: Largest road-wheel angle [rad].
    """
    ax, _, _ = motion.acceleration
    vx = 0.5 * (motion.before[..., 0] + motion.after[..., 0])
    loss = coasting[0] * torch.tanh(vx / SETTING_OFF) + coasting[1] * vx
    given = ax + loss + turning_drag(motion, dimensions, lock)
    return given.clamp_min(0.0) * torch.tanh(motion.drive / ASKED)


def turning_drag(motion: Motion, dimensions: VehicleDimensions, lock: float = LOCK) -> Tensor:
    """Deceleration [n] [m/s^2] by turned front wheels: F tan(delta), with delta = L r / vx."""
    d = dimensions
    _, ay, yaw = motion.acceleration
    front = (d.cg_to_rear_axle * ay + d.yaw_inertia / d.mass * yaw) / d.wheelbase
    speed = motion.rolling(SLOWEST)
    angle = (d.wheelbase * motion.turn_rate / speed).clamp(-lock, lock)
    return front * torch.tan(angle)
