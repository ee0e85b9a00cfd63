"""Torques of motor and brakes at the four wheels, for every kind of command.

Arrays are [n] over environments and [4, n] over wheels and environments, of NumPy or PyTorch.
"""

from collections.abc import Mapping
from types import ModuleType
from typing import Literal

from array_api_compat import array_namespace

from buggy_rl.engines.bicycle.longitudinal import (
    current_force,
    esc_brakes,
    esc_drive,
    rolling_forward,
    setpoint_force,
)
from buggy_rl.engines.mujoco.actuators import motor_torque
from buggy_rl.engines.mujoco.arrays import Array, array_like
from buggy_rl.longitudinal import LongitudinalCommand

Drive = Literal["rear", "front", "all"]
SHARES = {"rear": (0.0, 0.0, 0.5, 0.5), "front": (0.5, 0.5, 0.0, 0.0), "all": (0.25,) * 4}
"""Driven axle -> share of the motor's force at each wheel; differentials are open."""
FRONT_SHARE = {"rear": 0.0, "front": 1.0, "all": 0.5}
"""Driven axle -> share of the motor's force at the front axle, where the motor brakes too."""

STOPS = 0.1  # [m/s] speed of a tread below which its brake is a damper; chosen
SLOPE_STEP = 1e-4  # [m/s] of the tread, over which the motor's slope is taken
LAWS = {"throttle_brake_reverse": esc_drive, "speed": setpoint_force, "current": current_force}


class Drivetrain:
    """Motor, differentials and brakes; without state.

    A two-way ESC brakes and does not reverse while the *car* rolls forward, even with locked
    wheels: it keeps braking until the command goes back. A speed controller sees the driven wheels.

    Args:
        values: Parameter name -> [1] or [n].
        radius: Of the wheels [m].
        command: What it follows.
        drive: Driven wheels.
    """

    def __init__(
        self,
        values: Mapping[str, Array],
        radius: float,
        command: LongitudinalCommand,
        drive: Drive,
    ) -> None:
        self.values, self.radius, self.command, self.drive = values, radius, command, drive
        force = values["drive_force"]
        self.shares = array_like(SHARES[drive], force)[:, None]  # (4, 1)
        # `Actuators.drive` has taken the dead zones out already.
        none = self._xp.zeros_like(force)
        self._law_values = {
            **values,
            "drive_force_loss": values["drive_speed_loss"],
            "throttle_deadband": none,
            "reverse_deadband": none,
        }

    @property
    def _xp(self) -> ModuleType:  # not kept: a module cannot be copied with the engine
        return array_namespace(self.shares)

    def torques(self, spin: Array, vx: Array, drive: Array) -> tuple[Array, Array]:
        """Torque [4, n] [N m] of motor and brakes at each wheel, and its slope [N m s].

        Args:
            spin: [4, n] rad/s.
            vx: [n] of the car [m/s].
            drive: [n] in 0..1, or -1..1 of a two-way command.
        """
        torque, slope = self._xp.zeros_like(spin), self._xp.zeros_like(spin)
        if self.command.kind == "throttle" and self.drive == "rear":
            torque[2:], slope[2:] = motor_torque(self.values, drive, spin[2:], self.radius)
            return torque, slope
        speed = self.radius * (self.shares * spin).sum(0)
        force = self._motor(speed, vx, drive)
        steeper = (self._motor(speed + SLOPE_STEP, vx, drive) - force) / SLOPE_STEP
        torque += self.radius * self.shares * force
        slope += self.radius**2 * self.shares * steeper
        return torque, slope

    def brakes(self, vx: Array, drive: Array) -> Array | None:
        """Largest torque [4, n] [N m] of each wheel's brake; None of a command without brakes."""
        if self.command.kind != "throttle_brake_reverse":
            return None
        pressed, dragging = esc_brakes(drive, self._law_values)
        force = pressed * rolling_forward(vx) + dragging  # (n,)
        front = self._xp.broadcast_to(self.values["brake_front_share"], force.shape)
        shares = self._xp.stack([front, front, 1 - front, 1 - front])
        return 0.5 * self.radius * force * shares

    def _motor(self, speed: Array, vx: Array, drive: Array) -> Array:
        """Force [n] [N] of the motor at all treads together, at their speed [n] [m/s]."""
        if self.command.kind == "throttle":
            return drive * (self.values["drive_force"] - self.values["drive_speed_loss"] * speed)
        law = LAWS[self.command.kind]
        return law(speed, rolling_forward(vx), drive, self._law_values)
