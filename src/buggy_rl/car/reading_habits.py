"""What shows only over several readings: a number that froze, and faults that come and go."""

from collections import deque
from typing import Deque, List, Tuple

from buggy_rl.car.interfaces import Reading

NAMES = ("vx", "vy", "yaw_rate")
LEARNT = 50  # pairs of readings after which a sensor's habit is known; half a second at 100 Hz
RARE = 0.02  # share of repeated numbers in a stream of noisy ones: a rounding to 1e-5 has 1e-4
FROZEN = 3  # repeats in a row of a number that does not repeat
BURSTS = 3  # faults, each after a good reading, within `WINDOW`
WINDOW = 0.15  # [s]


class FrozenNumber:
    """A velocity that is equal to the last bit again and again, and never was before.

    Some odometry comes in steps, or gives 0 for what it does not measure: its numbers repeat, from
    the first reading on, and nothing is said of them. A tracking camera's never do. 0 is no fault:
    filters give it for a car that stands. A position that froze differs from the way that the
    velocity makes, which `ReadingJudge` sees.
    """

    def __init__(self) -> None:
        self._last: Tuple[float, ...] = ()
        self._pairs = 0
        self._repeats: List[int] = [0] * len(NAMES)
        self._run: List[int] = [0] * len(NAMES)
        self._faulty: List[bool] = [False] * len(NAMES)

    def found(self, reading: Reading) -> str:
        """Takes a reading that differs from the last one; returns what of it is frozen."""
        last, self._last = self._last, reading.velocity
        if not last:
            return ""
        self._pairs += 1
        found = ""
        for index, name in enumerate(NAMES):
            value, run = reading.velocity[index], self._run[index]
            if value == last[index]:
                run += 1
            else:
                if not self._faulty[index]:  # a fault is no habit, however often it comes back
                    self._repeats[index] += run
                self._faulty[index], run = False, 0
            self._run[index] = run
            before = self._pairs - run
            lives = before >= LEARNT and self._repeats[index] <= RARE * before
            if lives and run >= FROZEN and value != 0:
                self._faulty[index] = True
                found = found or f"{name} is frozen at {value:.3f}, while the rest lives"
        return found


class Recurrence:
    """Faults that come and go: `BURSTS` of them within `WINDOW`, good readings in between."""

    def __init__(self) -> None:
        self._begun: Deque[float] = deque(maxlen=BURSTS)
        self._bad = False

    def recurs(self, now: float, fault: str) -> str:
        """Takes what was wrong with a reading at a time [s]; returns why a good one is not one."""
        if fault and not self._bad:
            self._begun.append(now)
        self._bad = bool(fault)
        many = len(self._begun) == BURSTS and now - self._begun[0] < WINDOW
        return f"{BURSTS} faults of the readings within {WINDOW:g} s" if many else ""
