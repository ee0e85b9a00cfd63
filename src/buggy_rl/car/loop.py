"""The control loop: reads, decides, commands and records once a period, on absolute deadlines."""

import gc
import math
from typing import Callable, List, NamedTuple, Optional

from buggy_rl.car.clock import Clock, Deadlines
from buggy_rl.car.interfaces import Command, Pilot, Reading, Sensor
from buggy_rl.car.own_stop import OwnStop
from buggy_rl.car.policy import PathDriver
from buggy_rl.car.recorder import CommandHistory, DriveRecorder, RecorderRow
from buggy_rl.car.stopping import Parent, StopSignals
from buggy_rl.car.supervisor import Decision, Supervisor
from buggy_rl.car.watchdog_link import Watchdog

BIN = 1e-5  # [s] width of a bin: a tenth of a step of 0.1 ms
BINS = 5000  # up to 50 ms, five control periods; longer steps share the last bin


class LoopTimes:
    """Counts durations [s]; memory and time of a count do not grow with the drive."""

    def __init__(self) -> None:
        self._counts: List[int] = [0] * (BINS + 1)
        self.count = 0
        self.longest = 0.0
        """The longest duration [s]."""

    def add(self, seconds: float) -> None:
        """Counts one duration."""
        self._counts[min(int(seconds / BIN), BINS)] += 1
        self.count += 1
        self.longest = max(self.longest, seconds)

    def quantile(self, share: float) -> float:
        """Least bin edge [s] that `share` of the durations do not exceed; NaN without any."""
        if not self.count:
            return math.nan
        left = math.ceil(share * self.count)
        for index, count in enumerate(self._counts):
            left -= count
            if left <= 0:
                return min((index + 1) * BIN, self.longest) if index < BINS else self.longest
        return self.longest


class Parts(NamedTuple):
    """What the loop works with; `drive` makes and closes them."""

    sensor: Sensor
    pilot: Pilot
    watchdog: Watchdog
    own: OwnStop
    recorder: DriveRecorder
    supervisor: Supervisor
    driver: Optional[PathDriver]
    clock: Clock


class Loop:
    """Loop of one drive.

    Args:
        parts: What it works with.
        period: Control period [s].
        say: Tells a person why the car is armed or not, at each change.

    Raises:
        ValueError: The policy has another control period.
    """

    def __init__(self, parts: Parts, period: float, say: Callable[[str], None]) -> None:
        self.parts, self.period = parts, period
        if parts.driver is not None:
            parts.driver.refuse_other_than(period)
        self.steps, self.missed, self.armings = 0, 0, 0
        self.times, self.delays = LoopTimes(), LoopTimes()
        self._history = CommandHistory(parts.supervisor.at_rest)
        self._seen: List[Reading] = []
        self._before = self._decision = Decision(parts.supervisor.limits.last, "neutral", False)
        self._first_armed: Optional[float] = None
        self._shown, self._say = "", say
        self._late = ""

    def run(self, signals: StopSignals, parent: Parent) -> str:
        """Drives until something ends it, a signal or the parent's end too; returns what.

        Raises:
            Exception: Whatever a part raises; the caller ends the watchdog, which stops the car.
        """
        clock = self.parts.clock
        deadlines = Deadlines(self.period, clock.now, clock.sleep)
        gc.collect()
        gc.disable()  # a collection pauses the loop for milliseconds; a step makes no cycles
        try:
            while True:
                deadlines.wait()
                begun = clock.now()
                stop = signals.caught or self._step(begun)
                if parent.gone:
                    stop = "the program that started the drive is gone"
                ended = clock.now()
                self._count(begun, ended, deadlines.due)
                if stop:
                    return stop
        finally:
            gc.enable()

    def _count(self, begun: float, ended: float, due: float) -> None:
        self.steps += 1
        self.times.add(ended - begun)
        self.delays.add(ended - due)
        self.missed += ended - due > self.period

    def _step(self, now: float) -> str:
        """One period; returns why the drive is over, or nothing."""
        parts = self.parts
        readings = parts.sensor.readings()
        self._listen(now)
        drivable = parts.supervisor.observe(now, readings)
        decision = self._decide(now, drivable)
        parts.watchdog.send(now, decision.command)
        if parts.watchdog.failing or self._late:
            parts.own.assist()
        parts.watchdog.listen()
        self._show()
        self._keep(readings, decision)
        late = "" if parts.own.shared else self._late
        return parts.watchdog.dead or late or parts.recorder.error or self._over(now)

    def _listen(self, now: float) -> None:
        """Takes the watchdog's reports, then records the readings that they complete.

        A row is written a step after its reading: by then it is known what acted at its stamp.
        """
        for report in self.parts.watchdog.reports():
            self._history.add(report)
        for reading in self._seen:
            acted, last = self._history.at(reading.stamp), self._before
            self.parts.recorder.put(RecorderRow(reading, acted, last.armed, last.source), now)

    def _decide(self, now: float, drivable: bool) -> Decision:
        parts, supervisor = self.parts, self.parts.supervisor
        own, was_armed = parts.pilot.command(self.period), supervisor.armed
        policy = self._policy() if drivable and was_armed else None
        self._late = parts.watchdog.late
        hold, hardware = parts.pilot.hold_to_drive, parts.watchdog.trouble or self._late
        decision = supervisor.decide(now, self.period, hold, own, policy, hardware)
        if policy is not None and parts.driver is not None:
            parts.driver.acted(decision.command)
        if supervisor.armed and not was_armed:
            self._begin(now)
        return decision

    def _policy(self) -> Optional[Command]:
        driver, reading = self.parts.driver, self.parts.supervisor.readings.good
        return None if driver is None or reading is None else driver.step(reading)

    def _begin(self, now: float) -> None:
        """The car was armed: the policy begins with the next step."""
        self.armings += 1
        reading = self.parts.supervisor.readings.good
        if self._first_armed is None:
            self._first_armed = now
        if self.parts.driver is not None and reading is not None:
            self.parts.driver.begin(reading)

    def _show(self) -> None:
        supervisor = self.parts.supervisor
        if supervisor.message != self._shown:
            self._shown = supervisor.message
            self.parts.pilot.show(supervisor.armed, self._shown)
            self._say(self._shown)

    def _keep(self, readings: List[Reading], decision: Decision) -> None:
        """What the next step records: these readings, and the decision that acted before this."""
        self._seen, self._before, self._decision = readings, self._decision, decision

    def _over(self, now: float) -> str:
        driver, limit = self.parts.driver, self.parts.supervisor.safety.max_seconds
        if self._first_armed is not None and now - self._first_armed > limit:
            return f"{limit:g} s of driving are over"
        return f"the policy {driver.ended}" if driver is not None and driver.ended else ""
