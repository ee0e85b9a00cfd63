"""Which command acted when: what the watchdog reports, asked by the stamps of readings."""

import collections
import math
from typing import Deque, NamedTuple

from buggy_rl.car.interfaces import NEUTRAL, Command
from buggy_rl.car.messages import Report

KEPT = 200  # commands; 2 s at 100 Hz, eight times the age at which a reading disarms


class Written(NamedTuple):
    """A command, and when the actuator took it [s]."""

    stamp: float
    throttle: float
    steering: float


class CommandHistory:
    """The commands that the actuator took last; neutral before the first."""

    def __init__(self, at_rest: Command = NEUTRAL) -> None:
        self._written: Deque[Written] = collections.deque(maxlen=KEPT)
        self._written.append(Written(-math.inf, *at_rest))

    def add(self, report: Report) -> None:
        """Takes a report; a write that failed changes nothing at the wheels."""
        if report.taken:
            self._written.append(Written(report.stamp, report.throttle, report.steering))

    def at(self, stamp: float) -> Written:
        """The command that acted at a time: the last one at or before it."""
        for written in reversed(self._written):
            if written.stamp <= stamp:
                return written
        return self._written[0]
