"""The rule of the watchdog: what the actuator is given, and when, whatever the loop does."""

import math
from typing import NamedTuple, Optional, Tuple

from buggy_rl.car.command_limits import command_fault
from buggy_rl.car.interfaces import NEUTRAL, Actuator, Command
from buggy_rl.car.messages import FAILING, GOOD, SILENT, CommandMessage, Report


class GuardTimes(NamedTuple):
    """Times of the watchdog [s]."""

    timeout: float = 0.1
    """Age of a command at which the wheels get neutral."""
    retry: float = 0.003
    """After a write that failed."""
    repeat: float = 0.01
    """Between writes of neutral that nobody asked for."""


class Guard:
    """Writes fresh commands; writes neutral when there are none and when a write failed.

    Once it took over, it keeps the wheels neutral until the loop itself commands neutral and a
    write of it succeeded: a loop that was asleep does not drive on with what it meant before.

    Args:
        actuator: What it writes to.
        times: Its times.
        now: The time [s]; the first command is due a timeout later.
        at_rest: No drive, wheels straight ahead.
    """

    def __init__(
        self, actuator: Actuator, times: GuardTimes, now: float, at_rest: Command = NEUTRAL
    ) -> None:
        self._actuator, self.times, self._at_rest = actuator, times, at_rest
        self.sequence, self.state = 0, GOOD
        self._fresh, self._wanted, self._due = now, at_rest, now
        self._asked_neutral = False

    def hear(self, command: CommandMessage, now: float) -> None:
        """Takes a command; one that is old, repeated or not a number counts as none."""
        pair = command.throttle, command.steering
        age = now - command.stamp
        sound = not command_fault(pair) and math.isfinite(age) and age <= self.times.timeout
        if command.sequence <= self.sequence or not sound:
            return
        self.sequence, self._fresh, self._due = command.sequence, command.stamp, now
        self._asked_neutral = pair == self._at_rest
        if self.state == GOOD:
            self._wanted = pair

    def silence(self) -> None:
        """The loop is gone: neutral from now on."""
        self._take_over(SILENT)
        self._fresh, self._due, self._asked_neutral = -math.inf, -math.inf, False

    def act(self, now: float) -> Optional[Tuple[Command, bool]]:
        """Writes what is due; returns the command and whether the actuator took it, else None."""
        if now - self._fresh > self.times.timeout and self.state == GOOD:
            self._take_over(SILENT)
            self._due, self._asked_neutral = now, False
        if now < self._due:
            return None
        wanted = self._wanted
        try:
            self._actuator.write(*wanted)
        except OSError:
            self._take_over(FAILING)
            self._due = now + self.times.retry
            return wanted, False
        if self._asked_neutral:
            self.state, self._asked_neutral = GOOD, False
        self._due = now + self.times.repeat if self.state != GOOD else math.inf
        return wanted, True

    def wait(self, now: float) -> float:
        """How long nothing is due [s]."""
        expires = self._fresh + self.times.timeout if self.state == GOOD else math.inf
        return max(0.0, min(self._due, expires) - now)

    def report(self, now: float, command: Command, taken: bool) -> Report:
        """What the loop is told after an attempt to write `command`."""
        return Report(self.sequence, now, *command, int(taken), self.state)

    def _take_over(self, state: int) -> None:
        self.state, self._wanted = state, self._at_rest
