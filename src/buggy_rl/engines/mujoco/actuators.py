"""From commands to road-wheel angle and drive: dead time, lag, steering range, speed controller.

Arrays are numpy float64 [n, 2] over environments, columns throttle and steering; a parameter is [1]
where all environments share it, else [n].
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from buggy_rl.engines.mujoco.declared import LONGEST_DEAD_TIME
from buggy_rl.longitudinal import ONE_WAY, LongitudinalCommand, drive_of

RESTING = (-1.0, 0.0)  # [-] throttle and steering commands of a car at rest: no drive, straight
_CHANNELS = ("throttle", "steering")


def memory_length(dt: float) -> int:
    """Past commands that the longest dead time needs, with interpolation."""
    return int(np.ceil(LONGEST_DEAD_TIME / dt - 1e-6)) + 1


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
        values: Mapping[str, NDArray],
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
        whole = np.floor(periods).clip(max=longest - 1)
        self._fraction = periods - whole
        self._whole = whole.astype(np.int64)

    @staticmethod
    def _by_channel(values: Mapping[str, NDArray], kind: str) -> NDArray:
        channels = (values[f"{channel}_{kind}"] for channel in _CHANNELS)
        return np.stack(np.broadcast_arrays(*channels), -1)

    def delayed(self, memory: NDArray, action: NDArray) -> NDArray:
        """Command [n, 2] of this control period behind the dead time.

        u' = (1 - f) u[k - m] + f u[k - m - 1],  dead time = (m + f) dt: the mean over the period
        of the delayed staircase, continuous in the dead time.

        Args:
            memory: [n, N, 2] past commands, oldest first.
            action: [n, 2] the present one.
        """
        commands = np.concatenate([memory, action[:, None]], 1)  # (n, N + 1, 2)
        newest = commands.shape[1] - 1
        if self._whole.shape[0] == 1:
            index = newest - self._whole[0]
            near, far = commands[:, index, [0, 1]], commands[:, index - 1, [0, 1]]
        else:
            index = (newest - self._whole)[:, None]  # (n, 1, 2)
            near = np.take_along_axis(commands, index, 1)[:, 0]
            far = np.take_along_axis(commands, index - 1, 1)[:, 0]
        return near + self._fraction * (far - near)

    def lagged(self, start: NDArray, target: NDArray, elapsed: float) -> NDArray:
        """First-order lag [n, 2] towards a constant target, solved exactly.

        y(t) = u + (y(0) - u) exp(-t / time_constant).
        """
        # A time constant of 0 is no lag.
        decay = np.exp(-elapsed / np.maximum(self._time_constants, 1e-9))
        return target + (start - target) * decay

    def steering_angle(self, command: NDArray) -> NDArray:
        """Road-wheel angle [n] [rad], positive to the left, of a lagged command [n].

        delta = offset + left * max(s, 0) + right * min(s, 0).
        """
        left, right = self.values["steering_left"], self.values["steering_right"]
        turn = left * np.maximum(command, 0.0) + right * np.minimum(command, 0.0)
        return self.values["steering_offset"] + turn

    def drive(self, command: NDArray) -> NDArray:
        """Motor drive [n] of a lagged throttle command [n]: in 0..1, two-way in -1..1.

        d = max(0, (u - deadband) / (1 - deadband)),  u = (throttle + 1) / 2; of a two-way throttle
        likewise on both sides of 0. Setpoints and currents have no dead zone.
        """
        if self.command.kind in ("speed", "current"):
            return drive_of(command, self.command.rest)
        deadband = self.values["throttle_deadband"]
        if self.command.two_way:
            behind = self.values["reverse_deadband"]
            forward = np.maximum((command - deadband) / (1.0 - deadband), 0.0)
            return forward - np.maximum((-command - behind) / (1.0 - behind), 0.0)
        return np.maximum((0.5 * (command + 1.0) - deadband) / (1.0 - deadband), 0.0)


def motor_torque(
    values: Mapping[str, NDArray], drive: NDArray, spin: NDArray, radius: float
) -> tuple[NDArray, NDArray]:
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
