"""Drivers of the simulated car: a sensor and an actuator over a local socket."""

import collections
import socket
import struct
import threading
from typing import Any, Deque, List, Mapping, NamedTuple, Optional

from buggy_rl.car.interfaces import Actuator, Reading, Sensor
from buggy_rl.car.settings import section

SENSOR, ACTUATOR, CONTROL = b"sensor", b"actuator", b"control"
"""What a connection is for: the first message to the simulated car."""
READING = struct.Struct("<8d")  # stamp, x, y, yaw, vx, vy, yaw_rate, confidence
WRITE = struct.Struct("<2d")  # throttle, steering
TAKEN, REFUSED = b"\0", b"\1"
KEPT = 200  # readings that wait for the loop; 2 s at 100 Hz
SLOWEST_ANSWER = 0.04  # [s] to a write; a command at 100 kHz on the bus takes 0.6 ms


class Address(NamedTuple):
    """Where the simulated car listens."""

    address: str
    """File of its socket."""


class SimulatedSensor(Sensor):
    """Readings of the simulated camera.

    Raises:
        OSError: Nobody listens at the address.
    """

    def __init__(self, address: str) -> None:
        self._link = connected(address, SENSOR)
        self._latest: Optional[Reading] = None
        self._new: Deque[Reading] = collections.deque(maxlen=KEPT)
        self._thread = threading.Thread(target=self._run, name="simulated sensor", daemon=True)
        self._thread.start()

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "SimulatedSensor":
        """Of its settings: `address`."""
        return cls(section(Address, settings, "sensor").address)

    def _run(self) -> None:
        while True:
            try:
                message = self._link.recv(1024)
            except OSError:
                return
            if not message:
                return
            self._latest = unpacked(message)
            self._new.append(self._latest)

    def latest(self) -> Optional[Reading]:
        return self._latest

    def readings(self) -> List[Reading]:
        return [self._new.popleft() for _ in range(len(self._new))]

    def close(self) -> None:
        _shut(self._link)
        self._thread.join()


class SimulatedActuator(Actuator):
    """The simulated PWM board: it answers each write as the bus acknowledges it.

    Raises:
        OSError: Nobody listens at the address.
    """

    def __init__(self, address: str) -> None:
        self._link = connected(address, ACTUATOR)
        self._link.settimeout(SLOWEST_ANSWER)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "SimulatedActuator":
        """Of its settings: `address`."""
        return cls(section(Address, settings, "actuator").address)

    def write(self, throttle: float, steering: float) -> None:
        self._link.send(WRITE.pack(throttle, steering))
        if self._link.recv(16) != TAKEN:
            raise OSError("the simulated PWM board does not acknowledge")

    def close(self) -> None:
        _shut(self._link)


def connected(address: str, role: bytes) -> socket.socket:
    """A connection to the simulated car.

    Raises:
        OSError: Nobody listens there.
    """
    link = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        link.connect(address)
    except OSError as error:
        link.close()
        raise OSError(f"no simulated car listens at {address} ({error}): start it first") from None
    link.send(role)
    return link


def packed(reading: Reading) -> bytes:
    """A reading as bytes."""
    return READING.pack(reading.stamp, *reading.pose, *reading.velocity, reading.confidence)


def unpacked(message: bytes) -> Reading:
    """The reading in bytes."""
    stamp, x, y, yaw, vx, vy, yaw_rate, confidence = READING.unpack(message)
    return Reading(stamp, (x, y, yaw), (vx, vy, yaw_rate), confidence)


def _shut(link: socket.socket) -> None:
    """Closes a connection, also under a thread that waits for it."""
    try:
        link.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # closed before
    finally:
        link.close()
