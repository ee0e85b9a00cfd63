"""A drive from its config to its end: parts are made, the loop runs, all is closed in order.

The config file of a car is JSON; each section is checked where it is used.
"""

import contextlib
import json
import os
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Union

from buggy_rl.car.clock import Clock, has_priority, wall_time
from buggy_rl.car.guard import GuardTimes
from buggy_rl.car.interfaces import PILOTS, SENSORS, Command, make_device, neutral_of
from buggy_rl.car.loop import Loop, Parts
from buggy_rl.car.messages import READ_BACK, REFUSED
from buggy_rl.car.own_stop import OwnStop
from buggy_rl.car.policy import make_path_driver
from buggy_rl.car.recorder import DriveRecorder, new_recording
from buggy_rl.car.safety import Geofence, Safety, make_geofence
from buggy_rl.car.settings import section
from buggy_rl.car.stopping import Parent, StopSignals
from buggy_rl.car.supervisor import Supervisor
from buggy_rl.car.watchdog_link import Watchdog

ASKING = ("pca9685", "buggy_rl.car.ros:AckermannActuator", "joystick", "keyboard")
SECTIONS = ("sensor", "actuator", "pilot", "policy")


class CarConfig(NamedTuple):
    """What is on the car and what it may do."""

    sensor: Mapping[str, Any]
    """`kind` and settings of the driver, as of `devices.SENSORS`."""
    actuator: Mapping[str, Any]
    """`kind` and settings of the driver, as of `devices.ACTUATORS`."""
    pilot: Mapping[str, Any]
    """`kind` and settings of the person with the button, as of `devices.PILOTS`."""
    policy: Mapping[str, Any]
    """`kind` and settings, as of `driver.make_driver`."""
    output: str
    """Folder of the recordings."""
    geofence: Union[str, Mapping[str, Any]]
    """Area where the car may be, as of `geofence.make_geofence`."""
    safety: Mapping[str, Any] = {}
    """Limits that differ from those of `Safety`."""
    two_way: bool = False
    """Whether the speed controller brakes and reverses: no drive is throttle 0, -1 full brake or
    reverse. False: no drive is -1, and there is no reverse."""
    period: float = 0.01
    """Control period [s]; that of the policy."""
    speed: float = 1.0
    """Speed of time; above 1 only for a simulated car."""

    @property
    def at_rest(self) -> Command:
        """No drive, wheels straight ahead."""
        return neutral_of(self.two_way)

    def told(self, about: Mapping[str, Any]) -> Mapping[str, Any]:
        """A section with `two_way`, where its driver is one of ours that asks for it.

        A driver of one's own is given commands as they are.
        """
        if not self.two_way or about["kind"] not in ASKING:
            return about
        return dict(about, two_way=True)

    @property
    def limits(self) -> Safety:
        """The safety limits."""
        return Safety.from_dict(self.safety)

    @property
    def fence(self) -> Geofence:
        """Fence of the area where the car may be."""
        return make_geofence(self.geofence)


RANGES = {"period": (0.002, 0.05), "speed": (0.1, 20.0)}


def make_config(content: Mapping[str, Any]) -> CarConfig:
    """A config of plain values, checked.

    Raises:
        ValueError: A key is missing or unknown, or a value is not allowed.
    """
    config = section(CarConfig, content, "car", RANGES)
    for name in SECTIONS:
        about = getattr(config, name)
        if not isinstance(about, Mapping) or not isinstance(about.get("kind"), str):
            raise ValueError(f'car.{name}={about!r}: must be an object with a "kind"')
    if config.speed != 1.0 and {config.sensor["kind"], config.actuator["kind"]} != {"simulated"}:
        raise ValueError(f"car.speed={config.speed:g}: time of a real car runs at speed 1")
    if not config.output:
        raise ValueError("car.output is empty: name the folder of the recordings")
    make_geofence(config.geofence)
    Safety.from_dict(config.safety)
    return config


def load_config(file: str) -> CarConfig:
    """Reads and checks a config file.

    Raises:
        ValueError: It is not JSON or not such a config; the message names the file.
        OSError: It cannot be read.
    """
    with open(file) as stream:
        try:
            return make_config(json.load(stream))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from None


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
