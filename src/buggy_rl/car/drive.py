"""A drive from its config to its end: parts are made, the loop runs, all is closed in order."""

import contextlib
import json
import os
from typing import Any, Callable, Dict, List, NamedTuple, Optional

from buggy_rl.car.clock import Clock, has_priority, wall_time
from buggy_rl.car.config import CarConfig
from buggy_rl.car.driver import make_path_driver
from buggy_rl.car.guard import GuardTimes
from buggy_rl.car.interfaces import PILOTS, SENSORS, make_device
from buggy_rl.car.loop import Loop, Parts
from buggy_rl.car.messages import READ_BACK, REFUSED
from buggy_rl.car.own_stop import OwnStop
from buggy_rl.car.recorder import DriveRecorder, new_recording
from buggy_rl.car.stopping import Parent, StopSignals
from buggy_rl.car.supervisor import Supervisor
from buggy_rl.car.watchdog_link import Watchdog


class Summary(NamedTuple):
    """How a drive went."""

    recording: str
    stopped: str
    """Why the drive ended."""
    steps: int
    missed: int
    """Steps whose command came later than a period after their deadline."""
    loop_p50: float
    """Median time of a step [s], from waking up to the command."""
    loop_p99: float
    loop_max: float
    delay_max: float
    """Longest time from a deadline to its command [s]."""
    armings: int
    rows: int
    rows_left_out: int
    """Readings whose stamp was not after the one before."""
    capped: int
    """Commands whose throttle was above the cap."""
    slowed: int
    """Commands that changed faster than the limits."""
    realtime: bool
    """The system lets the loop run before ordinary processes."""
    neutral_confirmed: bool
    """The actuator took neutral at the end."""
    read_back: bool = False
    """The board was asked, and held neutral."""
    by_loop: bool = False
    """The loop wrote it, because the watchdog could not."""
    refused: int = 0
    """Writes that the board did not take."""

    def lines(self) -> List[str]:
        """Says in lines for people how the drive went."""
        share = self.missed / max(1, self.steps)
        times = ", ".join(f"{1e3 * t:.2f}" for t in (self.loop_p50, self.loop_p99, self.loop_max))
        priority = "real-time" if self.realtime else "ordinary"
        last = "THE ACTUATOR DID NOT CONFIRM NEUTRAL: cut its power"
        if self.neutral_confirmed:
            last = "neutral was written last" + (", and read back" if self.read_back else "")
            last += " (by the loop: the watchdog could not)" if self.by_loop else ""
        return [
            f"stopped: {self.stopped}; {last}",
            f"{self.steps} steps at {priority} priority, {self.missed} deadlines missed "
            f"({share:.3%}); loop p50, p99, max {times} ms; latest command "
            f"{1e3 * self.delay_max:.2f} ms after its deadline",
            f"armed {self.armings} times; {self.capped} commands capped, {self.slowed} slowed down",
            f"{self.refused} writes that the board did not take",
            f"{self.recording}: {self.rows} rows, {self.rows_left_out} readings left out",
        ]


def drive_car(
    config: CarConfig,
    about: Dict[str, Any],
    say: Callable[[str], None],
    parent: Optional[Parent] = None,
) -> Summary:
    """Drives until something ends it.

    Args:
        config: The car.
        about: What the note beside the recording says beside the summary.
        say: Tells a person.
        parent: Whose end ends the drive.

    Raises:
        ValueError: A section of the config is wrong.
        OSError: A device, a file or the watchdog cannot be opened.
    """
    clock = Clock(config.speed)
    driver, limits = make_path_driver(config.policy, config.two_way), config.limits
    path, _ = new_recording(config.output)
    with contextlib.ExitStack() as stack:
        signals = stack.enter_context(StopSignals())
        sensor = make_device(SENSORS, config.sensor, "sensor")
        stack.callback(sensor.close)
        pilot = make_device(PILOTS, config.told(config.pilot), "pilot")
        stack.callback(pilot.close)
        recorder = DriveRecorder(path, clock.now())
        stack.callback(recorder.close)
        write_note(path, dict(about, begun=wall_time(), origin=recorder.origin))
        actuator, times = config.told(config.actuator), GuardTimes(period=config.period)
        watchdog = Watchdog(actuator, clock, times, config.two_way)
        ending = Ending(watchdog, say)
        stack.callback(ending.close)  # the first to be closed, whatever happened
        ending.own = own = OwnStop(actuator, clock, config.at_rest)
        supervisor = Supervisor(limits, config.fence, config.at_rest)
        parts = Parts(sensor, pilot, watchdog, own, recorder, supervisor, driver, clock)
        say(f"recording to {path}")
        loop = Loop(parts, config.period, say)
        try:
            stopped = loop.run(signals, parent or Parent(0))
        except Exception as error:
            ending.close()  # before anything that a full or a hanging disk could hold up
            with contextlib.suppress(OSError):
                write_note(path, dict(about, origin=recorder.origin, stopped=repr(error)))
            raise
        ending.close()
    summary = summarised(loop, stopped, ending)
    try:
        content = dict(about, origin=recorder.origin, ended=wall_time(), **summary._asdict())
        write_note(path, content)
    except OSError as error:
        say(f"the note beside {path} could not be written: {error}")
    return summary


class Ending:
    """Stops the car once: by the watchdog, or by the loop where the watchdog cannot."""

    def __init__(self, watchdog: Watchdog, say: Callable[[str], None]) -> None:
        self._watchdog, self._say, self._closed = watchdog, say, False
        self.own: Optional[OwnStop] = None
        self.done, self.by_loop = REFUSED, False

    def close(self) -> None:
        """The wheels get neutral; a second call does nothing."""
        if self._closed:
            return
        self._closed = True
        watchdog, own = self._watchdog, self.own
        try:
            watchdog.close()
            self.done = watchdog.confirmed
        finally:
            if not self.done and own is not None and not watchdog.trying:
                self._take_over(own)
        if own is not None:
            own.close()

    def _take_over(self, own: OwnStop) -> None:
        """Neutral by the loop; a board that takes none is said before it is waited for."""
        own.end(self._watchdog.process)
        with contextlib.suppress(Exception):
            self._say("the loop stops the car: the watchdog cannot; if it drives, cut its power")
        self.done, self.by_loop = own.stop(), True


def summarised(loop: Loop, stopped: str, ending: Ending) -> Summary:
    """The summary of a loop that has ended."""
    recorder, limits, times = loop.parts.recorder, loop.parts.supervisor.limits, loop.times
    return Summary(
        recording=recorder.path,
        stopped=stopped,
        steps=loop.steps,
        missed=loop.missed,
        loop_p50=times.quantile(0.5),
        loop_p99=times.quantile(0.99),
        loop_max=times.longest,
        delay_max=loop.delays.longest,
        armings=loop.armings,
        rows=recorder.rows,
        rows_left_out=recorder.left_out,
        capped=limits.capped,
        slowed=limits.slowed,
        realtime=has_priority(),
        neutral_confirmed=bool(ending.done),
        read_back=ending.done == READ_BACK,
        by_loop=ending.by_loop,
        refused=loop.parts.watchdog.refused,
    )


def write_note(recording: str, about: Dict[str, Any]) -> None:
    """Writes the note beside a recording, whole or not at all."""
    file = os.path.splitext(recording)[0] + ".json"
    with open(file + ".partial", "w") as stream:
        json.dump(about, stream, indent=1, sort_keys=True)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(file + ".partial", file)
