"""What the runtime asks of a sensor, of an actuator and of a person; drivers derive from these."""

from typing import List, NamedTuple, Optional, Tuple

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
    """When it was measured [s], on this computer's monotonic clock (`time.monotonic`)."""
    pose: Tuple[float, float, float]
    """x, y [m], yaw [rad] in the world frame."""
    velocity: Tuple[float, float, float]
    """vx, vy [m/s], yaw_rate [rad/s] in the body frame: x forward, y left."""
    confidence: float = 1.0
    """Of the tracker in its pose, from 0 (lost) to 1 (full)."""


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
    """Turns the motor and the wheels."""

    at_rest: Command = NEUTRAL
    """What `neutral` writes."""

    def write(self, throttle: float, steering: float) -> None:
        """Sends a command, both in [-1, 1]; it returns within a few milliseconds.

        Raises:
            OSError: The device did not take it.
        """
        raise NotImplementedError

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
