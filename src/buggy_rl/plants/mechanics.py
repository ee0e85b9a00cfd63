"""Faults between servo and road wheels, and between speed controller and motor.

Stages of the steering in series: dead centre, lag, stiction, rate limit, play, bent linkage, its
gains, end stop. Of the drive: lag, deadband, gain, battery and its resistance, heat, what the servo
takes. Arrays are [n] over environments, commands in [-1, 1].
"""

import numpy as np
from numpy.typing import NDArray

from buggy_rl.plants.faults import Faults

# Columns of the memory, with their values at rest.
RESTING = {
    **{"smoothed": 0.0, "servo": 0.0, "rack": 0.0, "throttle": -1.0, "minutes": 0.0},
    **{"held": 0.0, "going": 0.0, "horn": 0.0, "horn_speed": 0.0, "heat": 0.0},
}
(
    SMOOTHED, SERVO, RACK, THROTTLE, MINUTES, HELD, GOING, HORN, HORN_SPEED, HEAT
) = range(len(RESTING))  # fmt: skip
STAGES = frozenset(
    (
        "steering_lag", "steering_rate_limit", "steering_backlash", "steering_gain",
        "steering_asymmetry", "throttle_lag", "throttle_deadband", "throttle_gain", "battery_sag",
        "servo_stiction", "steering_dead_zone", "steering_curve", "steering_end_stop",
        "steering_play", "voltage_sag", "thermal_foldback", "brown_out",
    )
)  # fmt: skip
LET_GO = 0.1  # [-] share of the width at which a sticking servo rests again; chosen
PUSHED = 0.6  # [m/s^2] lateral acceleration at which the tyres have taken up half the play; chosen
DRAWN_AT = 5.0  # [1/s] speed of a servo that draws all it can
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
        """Memory [n, len(RESTING)] at rest."""
        return np.tile(np.array(list(RESTING.values())), (cars, 1))

    def steering(
        self, memory: NDArray, command: NDArray, lateral: NDArray | float = 0.0
    ) -> NDArray:
        """Rack position [n] of a step, in command units; updates `memory`.

        T dy/dt = u - y, |ds/dt| <= rate, |x - s| <= width / 2, times the gain of its side.

        Args:
            memory: [n, len(RESTING)].
            command: [n].
            lateral: Acceleration [n] [m/s^2], positive to the left, of which tyres push back.
        """
        rack = self._horn(memory, command)
        memory[:, HORN_SPEED] = (rack - memory[:, HORN]) / self.h
        memory[:, HORN] = rack
        return self._linkage(memory, rack, lateral)

    def _horn(self, memory: NDArray, command: NDArray) -> NDArray:
        """Servo position [n]."""
        faults = self.faults
        if "steering_dead_zone" in faults:
            width = faults["steering_dead_zone.width"]
            command = np.sign(command) * np.maximum(np.abs(command) - width, 0.0)
        if "steering_lag" in faults:
            command = self._lagged(memory, SMOOTHED, "steering_lag", command)
        if "servo_stiction" in faults:
            error, width = np.abs(command - memory[:, HELD]), faults["servo_stiction.width"]
            going = (error > width) | ((memory[:, GOING] > 0.5) & (error > LET_GO * width))
            memory[:, GOING] = going
            memory[:, HELD] = np.where(going, command, memory[:, HELD])
            command = memory[:, HELD].copy()
        if "steering_rate_limit" in faults:
            reach = faults["steering_rate_limit.rate"] * self.h
            moved = np.clip(command - memory[:, SERVO], -reach, reach)
            memory[:, SERVO] += moved
            command = memory[:, SERVO] - 0.5 * moved  # the mean over the step
        return command

    def _linkage(self, memory: NDArray, rack: NDArray, lateral: NDArray | float) -> NDArray:
        """Where the linkage [n] holds the wheels."""
        faults = self.faults
        if "steering_backlash" in faults:
            half = 0.5 * faults["steering_backlash.width"]
            memory[:, RACK] = np.clip(memory[:, RACK], rack - half, rack + half)
            rack = memory[:, RACK].copy()
        if "steering_play" in faults:
            pushed = 2.0 / np.pi * np.arctan(lateral / PUSHED)
            rack = rack - 0.5 * faults["steering_play.width"] * pushed
        if "steering_curve" in faults:
            bent = faults["steering_curve.curvature"]
            rack = rack * (1.0 - bent * (1.0 - rack * rack))
        if "steering_asymmetry" in faults:
            rack = rack * np.where(rack > 0, self._more_left, 1.0 / self._more_left)
        rack = rack * faults["steering_gain.gain"]
        if "steering_end_stop" in faults:
            left, right = (faults[f"steering_end_stop.{s}_cut"] for s in ("left", "right"))
            rack = np.clip(rack, right - 1.0, 1.0 - left)
        return rack

    def throttle(self, memory: NDArray, command: NDArray) -> NDArray:
        """Throttle [n] at the speed controller: T dy/dt = u - y, drive' = drive - width.

        It may be below -1, which is no drive. What is asked for heats: T dh/dt = drive^2 - h.
        """
        if "thermal_foldback" in self.faults:
            work = np.square(0.5 * (command + 1.0))
            rate = self.h / self.faults["thermal_foldback.time_constant"]
            memory[:, HEAT] += rate * (work - memory[:, HEAT])
        if "throttle_lag" in self.faults:
            command = self._lagged(memory, THROTTLE, "throttle_lag", command)
        return command - 2.0 * self.faults["throttle_deadband.width"]

    def duty(self, memory: NDArray, duty: NDArray) -> NDArray:
        """Duty cycle [n] of the motor behind gain and supply; above 1 of a higher voltage."""
        faults = self.faults
        if "voltage_sag" in faults:  # of a motor whose force goes with it
            duty = duty / (1.0 + faults["voltage_sag.resistance_ratio"] * np.square(duty))
        if "throttle_gain" in faults:
            duty = duty * faults["throttle_gain.gain"]
        if "battery_sag" in faults:
            lost = faults["battery_sag.loss_per_minute"] * memory[:, MINUTES]
            duty = duty * np.maximum(1.0 - lost, 0.0)
        if "thermal_foldback" in faults:
            duty = duty * (1.0 - faults["thermal_foldback.foldback"] * memory[:, HEAT])
        if "brown_out" in faults:
            fast = np.minimum(np.abs(memory[:, HORN_SPEED]) / DRAWN_AT, 1.0)
            held = faults["brown_out.holding"] * np.abs(memory[:, HORN])
            duty = duty * np.maximum(1.0 - faults["brown_out.moving"] * fast - held, 0.0)
        return duty

    def drained(self, memory: NDArray, force: NDArray) -> None:
        """Takes the charge of a step, with the motor's current in proportion to its force.

        dq/dt = e + (1 - e) F / F_typical, in minutes of mean driving per minute.

        Args:
            memory: [n, len(RESTING)], updated.
            force: [n] of the motor [N].
        """
        current = ELECTRONICS + (1.0 - ELECTRONICS) * np.maximum(force, 0.0) / self.typical
        memory[:, MINUTES] += current * self.h / 60.0

    def _lagged(self, memory: NDArray, column: int, effect: str, command: NDArray) -> NDArray:
        before = memory[:, column].copy()
        memory[:, column] = command + (before - command) * self._kept[effect]
        return 0.5 * (before + memory[:, column])
