"""Drivers of the simulated car: a sensor and an actuator over a local socket."""

import collections
import os
import socket
import struct
import threading
from typing import Any, Deque, List, Mapping, NamedTuple, Optional, Tuple

from buggy_rl.car.board_lock import hold, release
from buggy_rl.car.interfaces import Actuator, Reading, Sensor
from buggy_rl.car.settings import section

SENSOR, ACTUATOR, CONTROL = b"sensor", b"actuator", b"control"
"""What a connection is for: the first message to the simulated car."""
READING = struct.Struct("<8d")  # stamp, x, y, yaw, vx, vy, yaw_rate, confidence
WRITE = struct.Struct("<Q2d")  # number of the request, throttle, steering
LOOK = struct.Struct("<Q")  # number of a request for what the board holds
ANSWER = struct.Struct("<Qb2d")  # number of the request, 1 if done, what the board holds
KEPT = 200  # readings that wait for the loop; 2 s at 100 Hz
SLOWEST_ANSWER = 0.04  # [s] to a write; a command at 100 kHz on the bus takes 0.6 ms


class Address(NamedTuple):
    """Address at which the simulated car listens."""

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
        """Makes a sensor from settings: `address`."""
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
        self._number, self._lock = 0, _lock_of(address)
        hold(self._lock)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "SimulatedActuator":
        """Makes an actuator from settings: `address`."""
        return cls(section(Address, settings, "actuator").address)

    @classmethod
    def board(cls, settings: Mapping[str, Any]) -> str:
        return _lock_of(section(Address, settings, "actuator").address)

    @classmethod
    def second(cls, settings: Mapping[str, Any]) -> "SimulatedActuator":
        return SimulatedActuator.from_dict(settings)

    def write(self, throttle: float, steering: float) -> None:
        if not self._asked(WRITE, throttle, steering)[0]:
            raise OSError("the simulated PWM board does not acknowledge")

    def holds(self, throttle: float, steering: float) -> bool:
        return self._asked(LOOK)[1:] == (throttle, steering)

    def _asked(self, request: struct.Struct, *values: float) -> Tuple[int, float, float]:
        """What the board answers; an answer to an earlier request is no answer."""
        self._number += 1
        try:
            self._link.send(request.pack(self._number, *values))
            while True:
                message = self._link.recv(64)
                if not message:
                    raise ConnectionError("the simulated car has ended")
                number, done, throttle, steering = ANSWER.unpack(message)
                if number == self._number:
                    return done, throttle, steering
        except ConnectionError:
            self.gone = True
            raise

    def close(self) -> None:
        _shut(self._link)
        if self._lock:
            release(self._lock)
            self._lock = ""


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


def _lock_of(address: str) -> str:
    """File of a lock beside the socket, whose folder goes with the car; none where no socket is."""
    return address + ".lock" if os.path.exists(address) else ""


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
