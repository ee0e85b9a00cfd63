"""Filters of the command, as they stood in the task, and its bounds; each remembers u'."""

import math
from typing import Any, Mapping, Tuple

from buggy_rl.car.interfaces import NEUTRAL, Command
from buggy_rl.car.safety import Safety


def bounded(command: Command) -> Command:
    """Both commands within [-1, 1]; NaN stays NaN."""
    throttle, steering = command
    return min(max(throttle, -1.0), 1.0), min(max(steering, -1.0), 1.0)


class CommandFilter:
    """One of the filters; `key` is what observations call its last output."""

    key = ""

    def __init__(self, at_rest: Command = NEUTRAL) -> None:
        self._at_rest = at_rest
        self.now: Command = at_rest

    def reset(self) -> None:
        """No drive, wheels straight: the command before the first step."""
        self.now = self._at_rest

    def filtered(self, command: Command) -> Command:
        """u'_t of u_t, taken within [-1, 1]."""
        throttle, steering = bounded(command)
        self.now = self._next(0, throttle), self._next(1, steering)
        return self.now

    def _next(self, channel: int, asked: float) -> float:
        raise NotImplementedError


class LastAction(CommandFilter):
    """u'_t = u_t."""

    key = "last_action"

    def _next(self, channel: int, asked: float) -> float:
        return asked


class ActionSmoothing(CommandFilter):
    """u'_t = u'_{t-1} + share (u_t - u'_{t-1}), share = 1 - exp(-dt / time_constant)."""

    key = "smoothed_action"

    def __init__(self, share: float, at_rest: Command = NEUTRAL) -> None:
        super().__init__(at_rest)
        self._share = share

    def _next(self, channel: int, asked: float) -> float:
        return self.now[channel] + self._share * (asked - self.now[channel])


class RateLimit(CommandFilter):
    """u'_t = u'_{t-1} + (u_t - u'_{t-1}), changed by at most `largest` a step."""

    key = "limited_action"

    def __init__(self, largest: Tuple[float, float], at_rest: Command = NEUTRAL) -> None:
        super().__init__(at_rest)
        self._largest = largest

    def _next(self, channel: int, asked: float) -> float:
        most = self._largest[channel]
        return self.now[channel] + min(max(asked - self.now[channel], -most), most)


COMMANDS = {"last_action": LastAction, "action_smoothing": ActionSmoothing, "rate_limit": RateLimit}


def make_command_filter(about: Mapping[str, Any], at_rest: Command = NEUTRAL) -> CommandFilter:
    """The filter that an entry of a policy's JSON names, of a car with this neutral command."""
    options = {key: value for key, value in about.items() if key != "name"}
    return COMMANDS[about["name"]](at_rest=at_rest, **options)


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
