"""Judging readings: which one can be driven by, and faults that show over several of them."""

import math
from collections import deque
from typing import Deque, Iterable, List, Optional, Tuple

from buggy_rl.car.interfaces import Reading
from buggy_rl.car.safety import Safety

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


FUTURE = 0.005  # [s] granted to a stamp that is ahead of the clock: rounding between two clocks
DRIFT_TIME = 0.2  # [s] over which position and velocity are compared; a tracker's lag is below it
MOVING = 0.05  # [m/s] above it two readings of a moving car differ: 0.5 mm at 100 Hz


class ReadingJudge:
    """Tells good readings from bad ones; a bad reading counts as none.

    A sensor whose faults come and go is bad as a whole, although every second reading is good. A
    number that has changed with every reading and stops to is frozen, although the others live.
    A reading whose stamp is new and whose numbers are the old ones to the last bit is no news while
    the car moves or is armed: a frozen tracker is treated as a silent one. Displacements are
    compared with the velocity since the last good reading, so a tracker that found itself
    elsewhere stays bad until the car was disarmed.

    Args:
        safety: The limits.
    """

    def __init__(self, safety: Safety) -> None:
        self.safety = safety
        self.good: Optional[Reading] = None
        """The last good reading."""
        self.fault = "no reading yet"
        """What was wrong with the reading last judged; empty if it was good."""
        self._seen = -math.inf
        self._healthy_since = math.inf
        self._drift = 0.0, 0.0
        self._trusted = -math.inf
        self._last: Optional[Reading] = None
        self._frozen, self._recurrence = FrozenNumber(), Recurrence()

    def reset(self) -> None:
        """Forgets the last good reading: the next sound one is the new reference."""
        self.good, self._seen, self._healthy_since = None, -math.inf, math.inf
        self._drift, self._trusted = (0.0, 0.0), -math.inf

    def judge(self, now: float, readings: Iterable[Reading], armed: bool) -> None:
        """Takes the readings since the last call, oldest first.

        Args:
            now: The time [s].
            readings: Often one, sometimes none or two.
            armed: The car may drive, so that it has to be seen moving.
        """
        for reading in readings:
            if reading == self._last:
                continue  # the same frame again is no news, good or bad
            self._last = reading
            self.fault = self._fault(now, reading, armed)
            if math.isfinite(reading.stamp) and reading.stamp <= now + FUTURE:
                self._seen = reading.stamp
            recurs = self._recurrence.recurs(now, self.fault)
            if not self.fault:
                self.good = reading
                if not recurs:
                    self._trusted = reading.stamp
                else:
                    self.fault = recurs
        if self.age(now) > self.safety.coast_after:
            self._healthy_since = math.inf
        elif self._healthy_since == math.inf:
            self._healthy_since = now

    def age(self, now: float) -> float:
        """Time since the last good reading was measured [s]; infinite without one."""
        return now - self._trusted

    def fresh_for(self, now: float) -> float:
        """How long good readings have been coming in without a pause [s]; 0 if they are not."""
        return max(0.0, now - self._healthy_since)

    def complaint(self, now: float) -> str:
        """Why the car cannot be driven by the readings now."""
        age = self.age(now)
        if self.fault:
            return self.fault
        if age > self.safety.coast_after:
            return f"the last reading is {age * 1e3:.0f} ms old"
        return f"good readings for {self.fresh_for(now) * 1e3:.0f} ms only"

    def _fault(self, now: float, reading: Reading, armed: bool) -> str:
        numbers = (reading.stamp, *reading.pose, *reading.velocity, reading.confidence)
        if not all(map(math.isfinite, numbers)):
            return "a number of the reading is not finite"
        if reading.stamp > now + FUTURE:
            return f"the reading is stamped {reading.stamp - now:.3f} s in the future"
        if reading.stamp <= self._seen:
            return f"the stamps ran back by {self._seen - reading.stamp:.3f} s"
        return self._out_of_range(reading) or self._inconsistent(reading, armed)

    def _out_of_range(self, reading: Reading) -> str:
        limits, (x, y, _), (vx, vy, yaw_rate) = self.safety, reading.pose, reading.velocity
        speed = math.hypot(vx, vy)
        if reading.confidence < limits.least_confidence:
            return f"the tracker's confidence is {reading.confidence:.2f}"
        if max(abs(x), abs(y)) > limits.farthest:
            return f"the position ({x:.1f}, {y:.1f}) m is beyond {limits.farthest:g} m"
        if speed > limits.top_speed:
            return f"the speed {speed:.1f} m/s is above {limits.top_speed:g} m/s"
        if abs(yaw_rate) > limits.top_yaw_rate:
            return f"the yaw rate {yaw_rate:.1f} rad/s is above {limits.top_yaw_rate:g} rad/s"
        return ""

    def _inconsistent(self, reading: Reading, armed: bool) -> str:
        last, limits = self.good, self.safety
        if last is None:
            return ""
        if reading[1:3] == last[1:3]:
            moves = math.hypot(*reading.velocity[:2]) > MOVING
            return "the reading is frozen" if moves or armed else ""
        frozen = self._frozen.found(reading)
        if frozen:
            return frozen
        dt = reading.stamp - last.stamp
        (x, y), turned, leap = _differences(last, reading, dt)
        # Where the acceleration changes by `a`, the mean velocity misses a dt^2 / 12 of the way.
        missed = dt * dt / 12
        if math.hypot(x, y) > limits.jump_distance + limits.acceleration * missed:
            return f"the position jumped by {math.hypot(x, y):.2f} m"
        if turned > limits.jump_angle + limits.yaw_acceleration * missed:
            return f"the yaw jumped by {turned:.2f} rad"
        if leap > limits.jump_speed + limits.acceleration * dt:
            return f"the velocity jumped by {leap:.2f} m/s"
        return self._drifted(x, y, dt)

    def _drifted(self, x: float, y: float, dt: float) -> str:
        """Adds a difference [m] to those before, which fade over `DRIFT_TIME`."""
        fade = math.exp(-dt / DRIFT_TIME)
        drift = fade * self._drift[0] + x, fade * self._drift[1] + y
        off = math.hypot(*drift)
        if off > self.safety.drift_distance:
            return f"position and velocity have come apart by {off:.2f} m"
        self._drift = drift
        return ""


def _differences(
    last: Reading, reading: Reading, dt: float
) -> Tuple[Tuple[float, float], float, float]:
    """What the motion by the mean velocity leaves over: [m], [rad], and the change of vx, vy."""
    vx, vy, yaw_rate = ((a + b) / 2 for a, b in zip(last.velocity, reading.velocity))
    (x0, y0, yaw0), (x1, y1, yaw1) = last.pose, reading.pose
    turn = (yaw1 - yaw0 + math.pi) % (2 * math.pi) - math.pi
    cos, sin = math.cos(yaw0 + turn / 2), math.sin(yaw0 + turn / 2)
    x, y = x1 - x0 - dt * (cos * vx - sin * vy), y1 - y0 - dt * (sin * vx + cos * vy)
    leap = math.hypot(
        reading.velocity[0] - last.velocity[0], reading.velocity[1] - last.velocity[1]
    )
    return (x, y), abs(turn - dt * yaw_rate), leap
