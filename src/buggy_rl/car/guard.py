"""The rule of the watchdog: what the actuator is given, and when, whatever the loop does."""

import math
from typing import NamedTuple, Optional, Tuple

from buggy_rl.car.clock import Lateness
from buggy_rl.car.commands import command_fault
from buggy_rl.car.interfaces import NEUTRAL, Actuator, Command
from buggy_rl.car.messages import (
    ENDING,
    FAILING,
    GOOD,
    LATE,
    READ_BACK,
    REFUSED,
    SILENT,
    TAKEN,
    CommandMessage,
    Report,
)


class GuardTimes(NamedTuple):
    """Times of the watchdog [s]."""

    timeout: float = 0.1
    """Age of a command at which the wheels get neutral."""
    retry: float = 0.003
    """Wait after a write that failed."""
    repeat: float = 0.01
    """Time between writes of neutral that nobody asked for."""
    period: float = 0.01
    """Period of the loop's commands."""
    look: float = 0.05
    """Time between two looks at what the board holds, where it can be read; read at neutral."""


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
        self._late = Lateness(times.period)
        self._looked, self._rests = -math.inf, False

    @property
    def gone(self) -> bool:
        """Whether there is no board any more."""
        return self._actuator.gone

    def hear(self, command: CommandMessage, now: float) -> None:
        """Takes a command; one that is old, repeated or not a number counts as none."""
        pair = command.throttle, command.steering
        age = now - command.stamp
        sound = not command_fault(pair) and math.isfinite(age) and age <= self.times.timeout
        if command.sequence <= self.sequence or not sound:
            return
        if self.sequence:
            self._late.add(command.stamp - self._fresh)
        self.sequence, self._fresh, self._due = command.sequence, command.stamp, now
        self._asked_neutral = pair == self._at_rest
        if self.state == GOOD:
            self._wanted = pair

    def silence(self, sequence: int = 0) -> None:
        """The drive is over, by the command of this number if by one: neutral from now on."""
        self._take_over(ENDING)
        self.sequence = max(self.sequence, sequence)
        self._fresh, self._due, self._asked_neutral = -math.inf, -math.inf, False
        self._rests = False  # read it back once more

    def act(self, now: float) -> Optional[Tuple[Command, int]]:
        """Writes what is due; returns the command and what became of it, else None."""
        trouble = self._trouble(now) if self.state == GOOD else GOOD
        if trouble:
            self._take_over(trouble)
            self._due, self._asked_neutral = now, False
        if now < self._due:
            return None
        wanted = self._wanted
        try:
            done = self._written(wanted, now)
        except OSError:
            self._take_over(FAILING)
            self._due = now + self.times.retry
            return wanted, REFUSED
        if self._asked_neutral:
            self.state, self._asked_neutral = GOOD, False
        self._due = now + self.times.repeat if self.state != GOOD else math.inf
        return wanted, done

    def _trouble(self, now: float) -> int:
        """Why the commands are not to be driven by."""
        gap = now - self._fresh
        if gap > self.times.timeout:
            return SILENT
        return LATE if self.sequence and self._late.too_slow(gap) else GOOD

    def _written(self, wanted: Command, now: float) -> int:
        """Writes, and reads back a new neutral and now and then a drive.

        Raises:
            OSError: The board did not take it, or holds something else.
        """
        self._actuator.write(*wanted)
        rests = wanted == self._at_rest
        look = not self._rests if rests else now - self._looked >= self.times.look
        self._rests = False  # until the board was seen to
        held = self._actuator.holds(*wanted) if look else None
        if held is False:
            raise OSError("the board took a command and holds another")
        self._looked, self._rests = now if look else self._looked, rests
        return TAKEN if held is None else READ_BACK

    def wait(self, now: float) -> float:
        """How long nothing is due [s]."""
        expires = math.inf
        if self.state == GOOD:
            patience = self._late.patience() if self.sequence else math.inf
            expires = self._fresh + min(self.times.timeout, patience)
        return max(0.0, min(self._due, expires) - now)

    def report(self, now: float, command: Command, taken: int) -> Report:
        """What the loop is told after an attempt to write `command`."""
        return Report(self.sequence, now, *command, int(taken), self.state)

    def _take_over(self, state: int) -> None:
        self.state, self._wanted = state, self._at_rest
