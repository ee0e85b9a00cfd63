"""A loop in real time, on absolute deadlines."""

import time
from typing import Callable

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
        """By which the deadlines moved [s]."""

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
