"""Bounds of commands: finite, in range, no faster than the limits, no more than the cap."""

import math

from buggy_rl.car.interfaces import NEUTRAL, Command
from buggy_rl.car.safety import Safety

ROUNDING = 1e-6  # granted beyond [-1, 1] to a command in single precision


def command_fault(command: Command) -> str:
    """What makes a command one that nobody can have meant; empty if nothing does."""
    for name, value in zip(("throttle", "steering"), command):
        if not math.isfinite(value):
            return f"{name} {value} is not finite"
        if abs(value) > 1 + ROUNDING:
            return f"{name} {value:.3f} is outside [-1, 1]"
    return ""


class CommandLimits:
    """Bounds sound commands; counts how many it changed, which the summary of a drive tells.

    Args:
        safety: The limits.
        at_rest: No drive, wheels straight ahead.
    """

    def __init__(self, safety: Safety, at_rest: Command = NEUTRAL) -> None:
        self.safety, self._rest = safety, at_rest[0]
        self.capped = 0
        """Commands whose throttle was above the cap, or below the floor."""
        self.slowed = 0
        """Commands that changed faster than the limits."""
        self.last = at_rest
        """The last command given out."""

    def bounded(self, command: Command, dt: float) -> Command:
        """The nearest command within the limits, `dt` [s] after the last.

        The throttle falls at once, and a brake is let go at once: less drive is never the danger.
        """
        throttle, steering = (max(-1.0, min(1.0, value)) for value in command)
        limits, (last_throttle, last_steering) = self.safety, self.last
        if not limits.throttle_floor <= throttle <= limits.throttle_cap:
            throttle = max(limits.throttle_floor, min(limits.throttle_cap, throttle))
            self.capped += 1
        wanted = throttle, steering
        throttle = min(throttle, max(last_throttle, self._rest) + limits.throttle_rise * dt)
        reach = limits.steering_rate * dt
        steering = max(last_steering - reach, min(last_steering + reach, steering))
        self.slowed += (throttle, steering) != wanted
        self.last = throttle, steering
        return self.last

    def set(self, command: Command) -> Command:
        """Takes a command of the safety rules, which no rate delays, as the last."""
        self.last = command
        return command
