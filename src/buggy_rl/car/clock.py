"""Time on the car: the monotonic clock, absolute deadlines, priority, device stamps, lateness."""

import math
import os
import sys
import time
from collections import deque
from typing import Callable, Deque


class Clock:
    """Monotonic time of this computer, the same in all of its processes.

    Args:
        speed: Seconds of this clock in a real one; above 1 only where the car is simulated.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed

    def now(self) -> float:
        """The time [s]."""
        return time.monotonic() * self.speed

    def sleep(self, seconds: float) -> None:
        """Waits for so many seconds of this clock."""
        time.sleep(max(0.0, seconds) / self.speed)


def wall_time() -> str:
    """Date and time, ISO 8601; a label for people, never used for control."""
    return time.strftime("%Y-%m-%dT%H:%M:%S%z")


FARTHEST = 0.1  # [s] that a loop may be behind and catch up; beyond, time is given up


class Deadlines:
    """Deadline k is at start + k dt; a late step does not delay those after it.

    A loop that is more than `FARTHEST` behind does not race after the lost time, in which nobody
    could have driven: its deadlines move.

    Args:
        dt: Period [s].
        clock: Monotonic time [s].
        sleep: Waits for so many seconds.
    """

    def __init__(
        self,
        dt: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if not dt > 0:
            raise ValueError(f"dt={dt:g} s: must be above 0")
        self.dt, self._clock, self._sleep = dt, clock, sleep
        self._next = clock()
        self.due = self._next
        """Deadline of the step that `wait` returned for last [s]."""
        self.overruns = 0
        """Steps that began after the deadline of the one that follows them."""
        self.slipped = 0.0
        """Time by which the deadlines moved [s]."""

    def wait(self) -> None:
        """Sleeps until the next deadline; returns at once if that is over."""
        late = self._clock() - self._next
        if late < 0:
            self._sleep(-late)
        elif late > self.dt:
            self.overruns += 1
        self.due = self._next
        if late > FARTHEST:
            self._next += late
            self.slipped += late
        self._next += self.dt


# Priorities of SCHED_FIFO, 1..99; kernel threads that drive I2C have 50.
SIMULATION, LOOP, WATCHDOG = 10, 20, 30
# [s] after which a thread lets another run; Python's own 5 ms is half a period.
SWITCH_INTERVAL = 5e-4


def take_priority(priority: int) -> bool:
    """Runs this process, and the threads it makes from now on, before all ordinary ones.

    Returns:
        Whether the system allows it: root, or a limit `rtprio` in /etc/security/limits.conf.
    """
    sys.setswitchinterval(SWITCH_INTERVAL)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (PermissionError, AttributeError):  # the latter: no Linux
        return False
    return True


def has_priority() -> bool:
    """Whether `take_priority` was allowed in this process."""
    return hasattr(os, "SCHED_FIFO") and os.sched_getscheduler(0) == os.SCHED_FIFO


FRAMES = 200  # over which the fastest arrival counts; 1 s of the T265, in which clocks drift 0.1 ms


class DeviceClock:
    """t = stamp + min over the last frames of (arrival - stamp).

    The fastest of the last frames shows the offset of the two clocks and the shortest way; the
    others came later than that, not were measured later. A time is never after its arrival. Where
    the device's clock steps back, times are too old by the step until the frames before it are
    forgotten: a runtime that judges their age stops the car meanwhile.

    Args:
        frames: Kept.
    """

    def __init__(self, frames: int = FRAMES) -> None:
        self._offsets: Deque[float] = deque(maxlen=frames)

    def time(self, stamp: float, arrival: float) -> float:
        """Measurement time of a frame [s], on the monotonic clock; NaN for a stamp that is none.

        Args:
            stamp: By the device's clock [s].
            arrival: By the monotonic clock [s].
        """
        if not math.isfinite(stamp):
            return math.nan
        self._offsets.append(arrival - stamp)
        return stamp + min(self._offsets)


GRANTED = 2.0  # periods between two messages that are not counted
DRAIN = 0.15  # of the time that messages come as they should, taken off what was behind
LARGEST = 0.04  # [s] that a gap counts for at most: a single stall has a limit of its own, 0.1 s
MOST = 0.043  # [s] behind, from which the process is too slow
REMEMBERED = 0.06  # [s] at most: what kept up for 0.1 s is no longer too slow


class Lateness:
    """behind' = max(0, behind - DRAIN min(gap, granted)) + min(max(0, gap - granted), LARGEST).

    A loop that is stopped for 80 ms again and again, or that runs at 25 Hz instead of 100, is never
    silent for 0.1 s, and its commands are old nevertheless. At 100 Hz a process that keeps up
    45 messages a second is never too slow, one of 25 is after 0.12 s.

    Args:
        period: Between two messages [s].
    """

    def __init__(self, period: float) -> None:
        self._granted = GRANTED * period
        self._behind = 0.0

    def add(self, gap: float) -> None:
        """Takes the time [s] between two messages."""
        self._behind = min(self.behind(gap), REMEMBERED)

    def behind(self, gap: float) -> float:
        """How far it is behind [s] if the gap so far is as long as this one [s]."""
        drained = max(0.0, self._behind - DRAIN * min(gap, self._granted))
        return drained + min(max(0.0, gap - self._granted), LARGEST)

    def too_slow(self, gap: float) -> bool:
        """Whether it is too slow already, the gap [s] being as long as this."""
        return self.behind(gap) > MOST

    def patience(self) -> float:
        """The gap [s] from which it is too slow; infinite if no single one is."""
        needed = MOST - max(0.0, self._behind - DRAIN * self._granted)
        return self._granted + needed if needed < LARGEST else float("inf")
