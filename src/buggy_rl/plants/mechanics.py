"""Faults between servo and road wheels, and between speed controller and motor.

Stages of the steering in series: lag, rate limit, play, linkage. Of the drive: lag, deadband, gain,
battery. Arrays are [n] over environments, commands in [-1, 1].
"""

import numpy as np
from numpy.typing import NDArray

from buggy_rl.plants.faults import Faults

# Columns of the memory, with their values at rest.
RESTING = {"smoothed": 0.0, "servo": 0.0, "rack": 0.0, "throttle": -1.0, "minutes": 0.0}
SMOOTHED, SERVO, RACK, THROTTLE, MINUTES = range(len(RESTING))
STAGES = frozenset(
    (
        "steering_lag", "steering_rate_limit", "steering_backlash", "steering_gain",
        "steering_asymmetry", "throttle_lag", "throttle_deadband", "throttle_gain", "battery_sag",
    )
)  # fmt: skip
ELECTRONICS = 0.3  # [-] share of computer and camera in the mean battery current; chosen


class Mechanics:
    """The stages of all environments; a stage without a fault passes its input.

    Args:
        faults: Of the stages.
        h: Step [s].
        typical: Mean force [N] of the plant's motor in room drives, by which charge is counted in
            minutes of driving.
    """

    def __init__(self, faults: Faults, h: float, typical: float) -> None:
        self.faults, self.h, self.typical = faults, h, typical
        self.active = bool(STAGES & faults.active)
        self._kept = {
            name: float(np.exp(-h / max(faults[f"{name}.time_constant"], 1e-9)))
            for name in ("steering_lag", "throttle_lag")
        }
        self._more_left = float(np.sqrt(faults["steering_asymmetry.left_to_right"]))

    @staticmethod
    def rest(cars: int) -> NDArray:
        """Memory [n, 5] at rest."""
        return np.tile(np.array(list(RESTING.values())), (cars, 1))

    def steering(self, memory: NDArray, command: NDArray) -> NDArray:
        """Rack position [n] of a step, in command units; updates `memory`.

        T dy/dt = u - y, |ds/dt| <= rate, |x - s| <= width / 2, times the gain of its side.
        """
        faults = self.faults
        if "steering_lag" in faults:
            command = self._lagged(memory, SMOOTHED, "steering_lag", command)
        if "steering_rate_limit" in faults:
            reach = faults["steering_rate_limit.rate"] * self.h
            moved = np.clip(command - memory[:, SERVO], -reach, reach)
            memory[:, SERVO] += moved
            command = memory[:, SERVO] - 0.5 * moved  # the mean over the step
        if "steering_backlash" in faults:
            half = 0.5 * faults["steering_backlash.width"]
            memory[:, RACK] = np.clip(memory[:, RACK], command - half, command + half)
            command = memory[:, RACK].copy()
        if "steering_asymmetry" in faults:
            command = command * np.where(command > 0, self._more_left, 1.0 / self._more_left)
        return command * faults["steering_gain.gain"]

    def throttle(self, memory: NDArray, command: NDArray) -> NDArray:
        """Throttle [n] at the speed controller: T dy/dt = u - y, drive' = drive - width.

        It may be below -1, which is no drive.
        """
        if "throttle_lag" in self.faults:
            command = self._lagged(memory, THROTTLE, "throttle_lag", command)
        return command - 2.0 * self.faults["throttle_deadband.width"]

    def duty(self, memory: NDArray, duty: NDArray) -> NDArray:
        """Duty cycle [n] of the motor behind gain, at most 1, and battery."""
        if "throttle_gain" in self.faults:
            duty = np.minimum(duty * self.faults["throttle_gain.gain"], 1.0)
        if "battery_sag" in self.faults:
            lost = self.faults["battery_sag.loss_per_minute"] * memory[:, MINUTES]
            duty = duty * np.maximum(1.0 - lost, 0.0)
        return duty

    def drained(self, memory: NDArray, force: NDArray) -> None:
        """Takes the charge of a step, with the motor's current in proportion to its force.

        dq/dt = e + (1 - e) F / F_typical, in minutes of mean driving per minute.

        Args:
            memory: [n, 5], updated.
            force: [n] of the motor [N].
        """
        current = ELECTRONICS + (1.0 - ELECTRONICS) * np.maximum(force, 0.0) / self.typical
        memory[:, MINUTES] += current * self.h / 60.0

    def _lagged(self, memory: NDArray, column: int, effect: str, command: NDArray) -> NDArray:
        before = memory[:, column].copy()
        memory[:, column] = command + (before - command) * self._kept[effect]
        return 0.5 * (before + memory[:, column])
