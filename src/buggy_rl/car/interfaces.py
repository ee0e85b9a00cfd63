"""What the runtime asks of a sensor, an actuator and a person, and the drivers by their names."""

import importlib
import json
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple

from buggy_rl.car.board_lock import lock_file

NO_DRIVE = -1.0  # throttle of a car without reverse: no drive, the car coasts
NEUTRAL = (NO_DRIVE, 0.0)  # throttle and steering: no drive, wheels straight ahead
TWO_WAY_NEUTRAL = (0.0, 0.0)  # of a car with brakes and reverse, for which -1 is full reverse

Command = Tuple[float, float]
"""Throttle and steering in [-1, 1]: no drive is -1, 0 where the car reverses; +1 is full left."""


def neutral_of(two_way: bool) -> Command:
    """No drive, wheels straight ahead."""
    return TWO_WAY_NEUTRAL if two_way else NEUTRAL


class Reading(NamedTuple):
    """The motion of the car's reference point at an instant."""

    stamp: float
    """Time of the measurement [s], on this computer's monotonic clock (`time.monotonic`)."""
    pose: Tuple[float, float, float]
    """x, y [m], yaw [rad] in the world frame."""
    velocity: Tuple[float, float, float]
    """vx, vy [m/s], yaw_rate [rad/s] in the body frame: x forward, y left."""
    confidence: float = 1.0
    """Confidence of the tracker in its pose, from 0 (lost) to 1 (full)."""


class Sensor:
    """Measures the motion of the car; a driver reads its device in a thread of its own."""

    _given: Optional[Reading] = None

    def latest(self) -> Optional[Reading]:
        """The last reading, or None before the first; it never blocks.

        A driver passes on what the device says, NaN and old stamps included: the runtime judges
        it. An unplugged device goes on returning its last reading.
        """
        raise NotImplementedError

    def readings(self) -> List[Reading]:
        """All readings since the last call, oldest first; it never blocks.

        Here the last one, if it is new. A driver that keeps the others overrides this: a frame that
        comes twice in a period of the loop is otherwise missing in the recording.
        """
        reading = self.latest()
        if reading is None or reading is self._given:
            return []
        self._given = reading
        return [reading]

    def close(self) -> None:
        """Lets go of the device; a second call does nothing."""


class Actuator:
    """Turns the motor and the wheels.

    Two processes of one runtime command a board: the watchdog, and the loop where the watchdog is
    gone or cannot. No other program can: the file that `board` names is locked.
    """

    at_rest: Command = NEUTRAL
    """What `neutral` writes."""
    gone: bool = False
    """Whether no board is there any more, and so nothing to stop: a simulated one has ended."""

    @classmethod
    def board(cls, settings: Mapping[str, Any]) -> str:
        """The file that is locked while a program commands the board of these settings.

        Here by the settings: state another where two settings may mean one board.
        """
        given = json.dumps(dict(settings), sort_keys=True)
        return lock_file(f"{cls.__module__}.{cls.__qualname__} {given}")

    @classmethod
    def second(cls, settings: Mapping[str, Any]) -> Optional["Actuator"]:
        """A second handle of a board that is in use, without disturbing it, or None.

        By it the loop writes neutral where the watchdog cannot. None, as here, is for a device that
        only one process can open: the loop then ends the watchdog before it opens the device by
        `from_dict`, which must take less than 20 ms.

        Raises:
            OSError: The device cannot be opened.
        """
        return None

    def write(self, throttle: float, steering: float) -> None:
        """Sends a command, both in [-1, 1]; it returns within a few milliseconds.

        Raises:
            OSError: The device did not take it.
        """
        raise NotImplementedError

    def holds(self, throttle: float, steering: float) -> Optional[bool]:
        """Whether the board holds a command, read back from it; None where it cannot be read.

        Raises:
            OSError: The device does not answer.
        """
        return None

    def neutral(self) -> None:
        """Sends no drive, wheels straight ahead.

        Raises:
            OSError: The device did not take it.
        """
        self.write(*self.at_rest)

    def close(self) -> None:
        """Lets go of the device without a command; a second call does nothing."""


class Pilot:
    """The person who answers for the car, at a joystick or a keyboard."""

    def command(self, dt: float) -> Optional[Command]:
        """The person's own command, or None where the car is left to the policy.

        None, too, where nobody is there. A command overrides the policy; the safety limits bound
        both. It never blocks.

        Args:
            dt: Since the last call [s], for ramps of keys.
        """
        raise NotImplementedError

    @property
    def hold_to_drive(self) -> bool:
        """The button that must be held for the car to drive is held now.

        False where nothing is heard of the device any more.
        """
        raise NotImplementedError

    def show(self, armed: bool, message: str) -> None:
        """Tells the person that the car was armed or disarmed, and why; called at each change."""

    def close(self) -> None:
        """Lets go of the device; a second call does nothing."""


SENSORS = {
    "simulated": "buggy_rl.car.simulated:SimulatedSensor",
    "t265": "buggy_rl.car.camera_t265:T265",
}
ACTUATORS = {
    "simulated": "buggy_rl.car.simulated:SimulatedActuator",
    "pca9685": "buggy_rl.car.pwm_pca9685:PCA9685",
}
PILOTS = {
    "scripted": "buggy_rl.car.human:ScriptedPilot",
    "joystick": "buggy_rl.car.joystick:Joystick",
    "keyboard": "buggy_rl.car.keyboard:Keyboard",
}


def device_class(
    drivers: Mapping[str, str], about: Mapping[str, Any], place: str
) -> Tuple[Any, Dict[str, Any]]:
    """The class that a section of the config names by `kind`, and its settings.

    Raises:
        ValueError: The kind is unknown.
    """
    settings: Dict[str, Any] = dict(about)
    kind = settings.pop("kind", None)
    if kind not in drivers and ":" not in str(kind):
        known = ", ".join(sorted(drivers))
        raise ValueError(f"{place}.kind={kind!r}: must be one of {known}, or MODULE:CLASS")
    module, _, name = drivers.get(kind, kind).partition(":")
    return getattr(importlib.import_module(module), name), settings


def make_device(drivers: Mapping[str, str], about: Mapping[str, Any], place: str) -> Any:
    """The driver that a section of the config names by `kind`.

    Args:
        drivers: `SENSORS`, `ACTUATORS` or `PILOTS`.
        about: `kind`, one of the names or MODULE:CLASS of a driver of your own, and the driver's
            own settings, which its class method `from_dict(settings)` checks.
        place: What messages call the section.

    Raises:
        ValueError: The kind is unknown or a setting is invalid.
        OSError: The device cannot be opened.
    """
    found, settings = device_class(drivers, about, place)
    return found.from_dict(settings)
