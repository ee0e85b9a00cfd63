"""The process of a simulated car.

`python -m buggy_rl.simulated_car.server CONFIG.json ADDRESS [PARENT SIGNALS]`, where PARENT is the
process that it ends with, and SIGNALS 1 if that one's main thread starts it.

Physics and camera run on a clock of their own; the wheels answer at once, in a thread.
"""

import json
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable
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
from buggy_rl.simulated_car.sensor_faults import SensorChannel

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
