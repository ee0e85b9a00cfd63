"""What the wheels were told and when, by the simulated car's own clock."""

import math
import threading
from collections import deque

from buggy_rl.car.clock import Clock
from buggy_rl.car.interfaces import NEUTRAL, Command

KEPT = 30_000  # writes; five minutes at 100 Hz

Entry = tuple[float, float, float]
"""Stamp [s], throttle, steering."""


class Wheels:
    """The simulated PWM board: holds the last command, as a real one does, and logs all of them.

    Args:
        clock: Of the simulated car.
        failsafe: Without a write for so long its hardware makes neutral [s]; 0 has none.
        at_rest: Neutral.
    """

    def __init__(self, clock: Clock, failsafe: float = 0.0, at_rest: Command = NEUTRAL) -> None:
        self._clock, self._failsafe, self._at_rest = clock, failsafe, at_rest
        self._lock = threading.Lock()
        self._log: deque[Entry] = deque([(clock.now(), *at_rest)], maxlen=KEPT)
        self._refusing_until = self._hanging_until = self._losing_until = -math.inf

    def refuse(self, until: float) -> None:
        """Takes no write before a time [s]."""
        self._refusing_until = until

    def hang(self, until: float) -> None:
        """Answers no write before a time [s], and does none of them."""
        self._hanging_until = until

    def lose(self, until: float) -> None:
        """Says that it takes each write before a time [s], and does none of them."""
        self._losing_until = until

    def write(self, throttle: float, steering: float) -> bool:
        """Takes a command; returns whether it did."""
        now = self._clock.now()
        if now < self._hanging_until:
            self._clock.sleep(self._hanging_until - now)
            return False
        if now < self._refusing_until:
            return False
        if now < self._losing_until:
            return True
        with self._lock:
            self._log.append((now, throttle, steering))
        return True

    def acting(self) -> Command:
        """What acts now."""
        with self._lock:
            last = self._log[-1]
            silent = self._clock.now() - last[0]
            if self._failsafe and silent > self._failsafe and last[1:] != self._at_rest:
                last = (self._clock.now(), *self._at_rest)
                self._log.append(last)
        return last[1:]

    def since(self, stamp: float) -> list[Entry]:
        """The commands that came after a time, oldest first, and the one that acted at it."""
        with self._lock:
            found: list[Entry] = []
            for entry in reversed(self._log):
                found.append(entry)
                if entry[0] <= stamp:
                    break
        return found[::-1]
