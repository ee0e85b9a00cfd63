"""Starting a simulated car, spoiling it, and reading its own log."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import TracebackType
from typing import Any

from buggy_rl.car.simulated import CONTROL, connected
from buggy_rl.config import plain
from buggy_rl.files import write_json
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.wheels import Entry

SLOWEST_START = 180.0  # [s] PyTorch is imported and, if asked for, the car compiled
SLOWEST_END = 5.0  # [s] until the processes that PyTorch compiles with are gone
LARGEST_ANSWER = 1 << 20  # bytes


class SimulatedCar:
    """A running simulated car, which ends with this process, however that ends.

    Args:
        config: The car.

    Raises:
        OSError: It did not start; its own message is on standard error.
    """

    def __init__(self, config: SimulatedCarConfig) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="buggy_rl_")
        self.address = str(Path(self._folder.name) / "car")
        """File of its socket."""
        file = Path(self._folder.name) / "config.json"
        write_json(file, plain(config))
        # The kernel takes the end of a thread for that of its process.
        main = threading.current_thread() is threading.main_thread()
        command = [sys.executable, "-m", "buggy_rl.simulated_car.server", str(file), self.address]
        self._process = subprocess.Popen(
            [*command, str(os.getpid()), str(int(main))], start_new_session=True
        )
        try:
            self._link = self._connected()
        except OSError:
            self.close()
            raise

    def _connected(self) -> socket.socket:
        end = time.monotonic() + SLOWEST_START
        while time.monotonic() < end and self._process.poll() is None:
            try:
                return connected(self.address, CONTROL)
            except OSError:
                time.sleep(0.05)  # not ready yet
        raise OSError("the simulated car did not start: see its message above")

    def ask(self, do: str, **arguments: Any) -> Any:
        """Asks the car.

        Raises:
            ValueError: It cannot do that.
        """
        self._link.send(json.dumps({"do": do, **arguments}).encode())
        answer = json.loads(self._link.recv(LARGEST_ANSWER))
        if isinstance(answer, dict) and "error" in answer:
            raise ValueError(answer["error"])
        return answer

    def spoil(self, kind: str, seconds: float, size: float = 0.0) -> float:
        """Begins a fault; returns when, by the car's clock [s].

        Args:
            kind: One of `SENSOR_FAULTS`, or of the board's: `pwm`, `hang`, `lose`.
            seconds: How long it lasts.
            size: How bad it is, where that can be chosen.
        """
        return self.ask("fault", kind=kind, seconds=seconds, size=size)

    def wheels(self, since: float) -> list[Entry]:
        """What the wheels were told after a time, and what acted at it."""
        return [tuple(entry) for entry in self.ask("wheels", stamp=since)]

    def sent(self, since: float) -> list[float]:
        """Stamps of the readings after a time that arrived as they were measured."""
        return self.ask("sent", since=since)

    @property
    def now(self) -> float:
        """The car's clock [s]."""
        return self.ask("state")["now"]

    def close(self) -> None:
        """Stops it."""
        self._process.terminate()
        self._process.wait()
        self._folder.cleanup()

    def __enter__(self) -> "SimulatedCar":
        """The car."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stops it."""
        # It may have stopped by itself, or not stop.
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            self.ask("stop")
            self._process.wait(SLOWEST_END)
        self._link.close()
        self.close()
