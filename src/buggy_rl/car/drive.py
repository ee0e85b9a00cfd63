"""A drive from its config to its end: parts are made, the loop runs, all is closed in order."""

import contextlib
import json
import os
from typing import Any, Callable, Dict, List, NamedTuple

from buggy_rl.car.clock import Clock, wall_time
from buggy_rl.car.config import CarConfig
from buggy_rl.car.devices import PILOTS, SENSORS, make_device
from buggy_rl.car.driver import make_driver
from buggy_rl.car.loop import Loop, Parts
from buggy_rl.car.priority import has_priority
from buggy_rl.car.recorder import DriveRecorder, new_recording
from buggy_rl.car.stopping import StopSignals
from buggy_rl.car.supervisor import Supervisor
from buggy_rl.car.watchdog_link import Watchdog


class Summary(NamedTuple):
    """How a drive went."""

    recording: str
    stopped: str
    """Why."""
    steps: int
    missed: int
    """Steps whose command came later than a period after their deadline."""
    loop_p50: float
    """Of the time of a step [s], from waking up to the command."""
    loop_p99: float
    loop_max: float
    delay_max: float
    """From a deadline to its command [s]."""
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

    def lines(self) -> List[str]:
        """For people."""
        share = self.missed / max(1, self.steps)
        times = ", ".join(f"{1e3 * t:.2f}" for t in (self.loop_p50, self.loop_p99, self.loop_max))
        priority = "real-time" if self.realtime else "ordinary"
        last = (
            "neutral was written last"
            if self.neutral_confirmed
            else ("THE ACTUATOR DID NOT CONFIRM NEUTRAL: cut its power")
        )
        return [
            f"stopped: {self.stopped}; {last}",
            f"{self.steps} steps at {priority} priority, {self.missed} deadlines missed "
            f"({share:.3%}); loop p50, p99, max {times} ms; latest command "
            f"{1e3 * self.delay_max:.2f} ms after its deadline",
            f"armed {self.armings} times; {self.capped} commands capped, {self.slowed} slowed down",
            f"{self.recording}: {self.rows} rows, {self.rows_left_out} readings left out",
        ]


def drive(config: CarConfig, about: Dict[str, Any], say: Callable[[str], None]) -> Summary:
    """Drives until something ends it.

    Args:
        config: The car.
        about: What the note beside the recording says beside the summary.
        say: Tells a person.

    Raises:
        ValueError: A section of the config is wrong.
        OSError: A device, a file or the watchdog cannot be opened.
    """
    clock = Clock(config.speed)
    driver, limits = make_driver(config.policy, config.two_way), config.limits
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
        watchdog = Watchdog(config.told(config.actuator), clock, two_way=config.two_way)
        ending = Ending(watchdog)
        stack.callback(ending.close)  # the first to be closed, whatever happened
        supervisor = Supervisor(limits, config.fence, config.at_rest)
        parts = Parts(sensor, pilot, watchdog, recorder, supervisor, driver, clock)
        say(f"recording to {path}")
        loop = Loop(parts, config.period, say)
        try:
            stopped = loop.run(signals)
        except Exception as error:
            write_note(path, dict(about, origin=recorder.origin, stopped=repr(error)))
            raise
    summary = summarised(loop, stopped, ending.confirmed)
    write_note(path, dict(about, origin=recorder.origin, ended=wall_time(), **summary._asdict()))
    return summary


class Ending:
    """Ends the watchdog once and keeps what it said."""

    def __init__(self, watchdog: Watchdog) -> None:
        self._watchdog = watchdog
        self.confirmed = False

    def close(self) -> None:
        """The wheels get neutral."""
        self.confirmed = self._watchdog.close()


def summarised(loop: Loop, stopped: str, confirmed: bool) -> Summary:
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
        neutral_confirmed=confirmed,
    )


def write_note(recording: str, about: Dict[str, Any]) -> None:
    """Writes the note beside a recording, whole or not at all."""
    file = os.path.splitext(recording)[0] + ".json"
    with open(file + ".partial", "w") as stream:
        json.dump(about, stream, indent=1, sort_keys=True)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(file + ".partial", file)
