"""Filters of the command, as they stood in the task; each remembers its last output u'."""

from typing import Any, Mapping, Tuple

from buggy_rl.car.interfaces import NEUTRAL, Command


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
