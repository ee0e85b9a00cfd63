"""The process of a simulated car.

`python -m buggy_rl.simulated_car.server CONFIG.json ADDRESS [PARENT SIGNALS]`, where PARENT is the
process that it ends with, and SIGNALS 1 if that one's main thread starts it.

Physics and camera run on a clock of their own; the wheels answer at once, in a thread. Faults of
the sensor, on demand, change readings on their way to the car.
"""

import json
import math
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from buggy_rl.car.clock import SIMULATION, Clock, Deadlines, take_priority
from buggy_rl.car.interfaces import Reading, neutral_of
from buggy_rl.car.simulated import ACTUATOR, ANSWER, CONTROL, LOOK, SENSOR, WRITE, packed
from buggy_rl.car.stopping import Parent
from buggy_rl.core.config import from_plain
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.physics import SimulatedBoard

LATE_ROWS = 15  # 0.15 s at 100 Hz: later than a car can be driven by
SPARSE_ROWS = 12  # one reading of so many: 8 Hz
STAMP_BACK = 0.03  # [s] of every second stamp
LOW_CONFIDENCE = 0.3  # in [0, 1]; the T265's "low" is 0.33


@dataclass
class Passage:
    """What a fault knows of the readings."""

    past: deque[Reading]
    """The readings so far, the present one last."""
    held: Reading
    """Reading before the fault began."""
    size: float
    """How bad: of a jump [m], of a step of the clock [s], of a drift [m/s]."""
    count: int = 0
    """Readings since the fault began."""


def _silent(passage: Passage) -> Reading | None:
    return None


def _frozen(passage: Passage) -> Reading | None:
    return passage.held._replace(stamp=passage.past[-1].stamp)


def _jumping(passage: Passage) -> Reading | None:
    x, y, yaw = passage.past[-1].pose
    angle = 2.4 * passage.size  # the direction of the jump follows its size
    pose = (x + passage.size * math.cos(angle), y + passage.size * math.sin(angle), yaw)
    return passage.past[-1]._replace(pose=pose)


def _sparse(passage: Passage) -> Reading | None:
    return None if passage.count % SPARSE_ROWS else passage.past[-1]


def _late(passage: Passage) -> Reading | None:
    return passage.past[max(-len(passage.past), -1 - LATE_ROWS)]


def _stamps_back(passage: Passage) -> Reading | None:
    back = STAMP_BACK if passage.count % 2 else 0.0
    return passage.past[-1]._replace(stamp=passage.past[-1].stamp - back)


def _velocity_frozen(passage: Passage) -> Reading | None:
    return passage.past[-1]._replace(velocity=passage.held.velocity)


def _pose_drifting(passage: Passage) -> Reading | None:
    x, y, yaw = passage.past[-1].pose
    way = passage.size * (passage.past[-1].stamp - passage.held.stamp)
    return passage.past[-1]._replace(pose=(x + way, y, yaw))


def _nan(passage: Passage) -> Reading | None:
    _, vy, yaw_rate = passage.past[-1].velocity
    return passage.past[-1]._replace(velocity=(math.nan, vy, yaw_rate))


def _unsure(passage: Passage) -> Reading | None:
    return passage.past[-1]._replace(confidence=LOW_CONFIDENCE)


def _clock_step(passage: Passage) -> Reading | None:
    return passage.past[-1]._replace(stamp=passage.past[-1].stamp + passage.size)


SENSOR_FAULTS: dict[str, Callable[[Passage], Reading | None]] = {
    "silent": _silent,
    "frozen": _frozen,
    "jumping": _jumping,
    "sparse": _sparse,
    "late": _late,
    "not_a_number": _nan,
    "unsure": _unsure,
    "clock_step": _clock_step,
    "stamps_back": _stamps_back,
    "velocity_frozen": _velocity_frozen,
    "pose_drifting": _pose_drifting,
}
"""Fault -> the reading that arrives, or None."""


class SensorChannel:
    """Passes readings on, spoilt while a fault lasts."""

    def __init__(self) -> None:
        self._past: deque[Reading] = deque(maxlen=LATE_ROWS + 1)
        self._fault: Callable[[Passage], Reading | None] | None = None
        self._until = -math.inf
        self._passage: Passage | None = None

    def spoil(self, kind: str, until: float, size: float = 0.0) -> None:
        """Begins a fault that ends at a time [s].

        Raises:
            ValueError: There is no such fault, or no reading yet.
        """
        if kind not in SENSOR_FAULTS:
            raise ValueError(f"fault {kind!r}: must be one of {', '.join(SENSOR_FAULTS)}")
        if not self._past:
            raise ValueError(f"fault {kind!r}: no reading was measured yet")
        self._fault, self._until = SENSOR_FAULTS[kind], until
        self._passage = Passage(self._past, self._past[-1], size)

    def passed(self, reading: Reading) -> tuple[Reading | None, bool]:
        """The reading that arrives, if one does, and whether it is as it was measured."""
        self._past.append(reading)
        if self._fault is None or self._passage is None or reading.stamp > self._until:
            self._fault = None
            return reading, True
        self._passage.count += 1
        return self._fault(self._passage), False


SENT_KEPT = 12_000  # stamps of readings that arrived as measured; two minutes


class Server:
    """Sockets around a car.

    Args:
        config: The car.
        address: File of the socket, which is made.
        parent: The process that it ends with.
    """

    def __init__(
        self, config: SimulatedCarConfig, address: str, parent: Parent | None = None
    ) -> None:
        from buggy_rl.simulated_car.physics import Physics

        self.clock = Clock(config.speed)
        self.physics = Physics(config)
        self.wheels = SimulatedBoard(self.clock, config.failsafe, neutral_of(config.two_way))
        self.channel = SensorChannel()
        self._sent: deque[float] = deque(maxlen=SENT_KEPT)
        self._sensors: list[socket.socket] = []
        self.deadlines = Deadlines(CONTROL_PERIOD, self.clock.now, self.clock.sleep)
        self._over, self._parent = threading.Event(), parent or Parent(0)
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(address)
        self._listener.listen()

    def run(self) -> None:
        """Drives until it is told to stop."""
        threading.Thread(target=self._accept, daemon=True).start()
        self.deadlines = Deadlines(CONTROL_PERIOD, self.clock.now, self.clock.sleep)
        while not self._over.is_set() and not self._parent.gone:
            self.deadlines.wait()
            command = self.wheels.acting()  # what acts from the stamp of the reading on
            self._measure()
            self.physics.step(command)

    def _measure(self) -> None:
        now, seen = self.clock.now(), self.physics.measured()
        if seen is None:
            return
        reading, sound = self.channel.passed(Reading(now, *seen))
        if reading is None:
            return
        if sound:
            self._sent.append(reading.stamp)
        for link in list(self._sensors):
            try:
                link.send(packed(reading), socket.MSG_DONTWAIT)
            except BlockingIOError:
                continue  # that reader is asleep; a camera does not wait for it either
            except OSError:
                self._sensors.remove(link)

    def _accept(self) -> None:
        while True:
            link, _ = self._listener.accept()
            threading.Thread(target=self._serve, args=(link,), daemon=True).start()

    def _serve(self, link: socket.socket) -> None:
        role = link.recv(64)
        if role == SENSOR:
            self._sensors.append(link)
            return
        answer = {ACTUATOR: self._write, CONTROL: self._control}.get(role)
        while answer is not None and (message := _received(link)):
            try:
                link.send(answer(message))
            except OSError:
                return  # the asker has gone
        link.close()

    def _write(self, message: bytes) -> bytes:
        if len(message) == LOOK.size:
            return ANSWER.pack(*LOOK.unpack(message), 1, *self.wheels.acting())
        number, *command = WRITE.unpack(message)
        return ANSWER.pack(number, self.wheels.write(*command), *command)

    def _control(self, message: bytes) -> bytes:
        request = json.loads(message)
        try:
            return json.dumps(self.requests[request.pop("do")](**request)).encode()
        except (ValueError, TypeError, KeyError) as error:
            return json.dumps({"error": str(error)}).encode()

    @property
    def requests(self) -> dict[str, Callable[..., Any]]:
        """What can be asked for over a control connection."""
        return {
            "fault": self.fault,
            "wheels": self.wheels.since,
            "sent": lambda since: [stamp for stamp in list(self._sent) if stamp > since],
            "state": self.state,
            "stop": self._over.set,
        }

    def fault(self, kind: str, seconds: float, size: float = 0.0) -> float:
        """Begins a fault; returns when [s]."""
        now = self.clock.now()
        spoilt = {"pwm": self.wheels.refuse, "hang": self.wheels.hang, "lose": self.wheels.lose}
        if kind in spoilt:
            spoilt[kind](now + seconds)
        else:
            self.channel.spoil(kind, now + seconds, size)
        return now

    def state(self) -> dict[str, Any]:
        """Time, the acting command, and how real time is kept."""
        deadlines = self.deadlines
        return {
            "now": self.clock.now(),
            "wheels": self.wheels.acting(),
            "overruns": deadlines.overruns,
            "slipped": deadlines.slipped,
        }


def _received(link: socket.socket) -> bytes:
    try:
        return link.recv(65536)
    except OSError:
        return b""


def main(arguments: list[str]) -> None:
    """Runs the process of the simulated car."""
    file, address, *family = arguments
    parent = Parent(int(family[0]), family[1] == "1") if family else Parent(0)

    import torch

    torch.set_num_threads(1)
    config = from_plain(SimulatedCarConfig, json.loads(Path(file).read_text()), file)
    server = Server(config, address, parent)
    take_priority(SIMULATION)  # a real car does not wait for the processor either
    server.run()


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except (ValueError, KeyError, OSError, FloatingPointError) as error:
        sys.exit(f"simulated car: {error.args[0] if error.args else error}")
