"""Turns commands into road-wheel angle and drive: dead time, lag, steering range, speed control.

Arrays, of NumPy or PyTorch, are [n, 2] over environments, columns throttle and steering; a
parameter is [1] where all environments share it, else [n].
"""

import math
from collections.abc import Mapping
from types import ModuleType
from typing import Any, Literal

from array_api_compat import array_namespace

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand, drive_of
from buggy_rl.simulators.bicycle.longitudinal import (
    current_force,
    esc_brakes,
    esc_drive,
    rolling_forward,
    setpoint_force,
)
from buggy_rl.simulators.mujoco.arrays import Array, array_like, indices_like, stacked
from buggy_rl.simulators.mujoco.declared import LONGEST_DEAD_TIME

RESTING = (-1.0, 0.0)  # [-] throttle and steering commands of a car at rest: no drive, straight
_CHANNELS = ("throttle", "steering")
NO_LAG = 1e-9  # [s]


def memory_length(dt: float) -> int:
    """Past commands that the longest dead time needs, with interpolation."""
    return math.ceil(LONGEST_DEAD_TIME / dt - 1e-6) + 1


class Actuators:
    """Servo and speed controller of n environments, without state of their own.

    Args:
        values: Parameter name -> [1] or [n].
        dt: Control period [s].
        command: What the first command is.

    Raises:
        ValueError: A dead time is negative or longer than the memory of commands.
    """

    def __init__(
        self,
        values: Mapping[str, Array],
        dt: float,
        command: LongitudinalCommand = ONE_WAY,
    ) -> None:
        self.values, self.command = values, command
        self._time_constants = self._by_channel(values, "lag")
        periods = self._by_channel(values, "dead_time") / dt  # (1 or n, 2)
        longest = memory_length(dt) - 1
        # 0.2 s in float32 is above 0.2 by its rounding, which is let pass.
        if (periods < 0).any() or (periods > longest * (1 + 1e-6)).any():
            raise ValueError(
                f"dead times of {periods.min() * dt:.4g} to {periods.max() * dt:.4g} s: must be "
                f"within 0 to {LONGEST_DEAD_TIME} s"
            )
        periods = periods.clip(0, longest)
        whole = self._xp.floor(periods).clip(max=longest - 1)
        self._fraction = periods - whole
        self._whole = self._xp.astype(whole, self._xp.int64)
        self._columns = indices_like([0, 1], periods)

    @property
    def _xp(self) -> ModuleType:  # not kept: a module cannot be copied with the engine
        return array_namespace(self._time_constants)

    @staticmethod
    def _by_channel(values: Mapping[str, Array], kind: str) -> Array:
        return stacked([values[f"{channel}_{kind}"] for channel in _CHANNELS], axis=-1)

    def delayed(self, memory: Array, action: Array) -> Array:
        """Command [n, 2] of this control period behind the dead time.

        u' = (1 - f) u[k - m] + f u[k - m - 1],  dead time = (m + f) dt: the mean over the period
        of the delayed staircase, continuous in the dead time.

        Args:
            memory: [n, N, 2] past commands, oldest first.
            action: [n, 2] the present one.
        """
        commands = self._xp.concat([memory, action[:, None]], axis=1)  # (n, N + 1, 2)
        newest = commands.shape[1] - 1
        if self._whole.shape[0] == 1:
            index = newest - self._whole[0]
            columns = self._columns
            near, far = commands[:, index, columns], commands[:, index - 1, columns]
        else:
            index = (newest - self._whole)[:, None]  # (n, 1, 2)
            near = self._xp.take_along_axis(commands, index, axis=1)[:, 0]
            far = self._xp.take_along_axis(commands, index - 1, axis=1)[:, 0]
        return near + self._fraction * (far - near)

    def lagged(self, start: Array, target: Array, elapsed: float) -> Array:
        """First-order lag [n, 2] towards a constant target, `elapsed` seconds on."""
        return target + (start - target) * step_left(self._time_constants, elapsed)

    def steering_angle(self, command: Array) -> Array:
        """Road-wheel angle [n] [rad], positive to the left, of a lagged command [n]."""
        return servo_angle(self.values, command)

    def drive(self, command: Array) -> Array:
        """Motor drive [n] of a lagged throttle command [n]: in 0..1, two-way in -1..1."""
        return motor_drive(self.values, self.command, command)


def step_left(time_constants: Array, elapsed: Any) -> Array:
    """What is left of a step `elapsed` seconds later behind a first-order lag, exp(-t / T).

    y(t) = u + (y(0) - u) exp(-t / T), exact for a constant u.
    """
    # A time constant of 0 is no lag.
    xp = array_namespace(time_constants)
    return xp.exp(-elapsed / xp.maximum(time_constants, NO_LAG))


def servo_angle(values: Mapping[str, Array], command: Array) -> Array:
    """Road-wheel angle [n] [rad], positive to the left, of a lagged command [n].

    delta = offset + left * max(s, 0) + right * min(s, 0).
    """
    xp = array_namespace(command)
    left, right = values["steering_left"], values["steering_right"]
    turn = left * xp.maximum(command, 0.0) + right * xp.minimum(command, 0.0)
    return values["steering_offset"] + turn


def motor_drive(values: Mapping[str, Array], kind: LongitudinalCommand, command: Array) -> Array:
    """Motor drive [n] of a lagged throttle command [n]: in 0..1, two-way in -1..1.

    d = max(0, (u - deadband) / (1 - deadband)),  u = (throttle + 1) / 2; of a two-way throttle
    likewise on both sides of 0. Setpoints and currents have no dead zone.
    """
    xp = array_namespace(command)
    if kind.kind in ("speed", "current"):
        return drive_of(command, kind.rest)
    deadband = values["throttle_deadband"]
    if kind.two_way:
        behind = values["reverse_deadband"]
        forward = xp.maximum((command - deadband) / (1.0 - deadband), 0.0)
        return forward - xp.maximum((-command - behind) / (1.0 - behind), 0.0)
    return xp.maximum((0.5 * (command + 1.0) - deadband) / (1.0 - deadband), 0.0)


def motor_torque(
    values: Mapping[str, Array], drive: Array, spin: Array, radius: float
) -> tuple[Array, Array]:
    """Torque of a DC motor at each rear wheel.

    T = d (F_stall - c omega r) r / 2,  dT/domega = -d c r^2 / 2.

    Args:
        values: `drive_force` [N], `drive_speed_loss` [N s/m]; [1] or [n].
        drive: [n] in 0..1.
        spin: [2, n] rear wheels [rad/s].
        radius: Of the wheel [m].

    Returns:
        Torque [n] [N m] and its slope [n] [N m s].
    """
    loss = values["drive_speed_loss"]
    speed = 0.5 * radius * (spin[0] + spin[1])  # of an open differential
    torque = 0.5 * radius * drive * (values["drive_force"] - loss * speed)
    return torque, -0.5 * radius**2 * drive * loss


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
