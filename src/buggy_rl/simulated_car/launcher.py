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
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from buggy_rl.car.path import Path as CarPath
from buggy_rl.car.path import path_lines
from buggy_rl.car.simulated import CONTROL, connected
from buggy_rl.core.config import plain_values
from buggy_rl.core.files import write_atomically, write_json
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.physics import Entry
from buggy_rl.task.paths.making import Kind, PathConfig, make_paths

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
        write_json(file, plain_values(config))
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
        """Stops the process."""
        self._process.terminate()
        self._process.wait()
        self._folder.cleanup()

    def __enter__(self) -> "SimulatedCar":
        """Enters with the car as it runs."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stops the car."""
        # It may have stopped by itself, or not stop.
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            self.ask("stop")
            self._process.wait(SLOWEST_END)
        self._link.close()
        self.close()


COURSES: Mapping[str, Kind] = {"lap": "lap", "infinity": "infinity", "random": "tight"}
"""Name of a course -> kind of path."""


def write_course(name: str, paths: PathConfig, folder: Path) -> Path:
    """Writes a course as the car reads it; returns the file.

    Raises:
        ValueError: There is no such course.
    """
    if name not in COURSES:
        raise ValueError(f"course={name!r}: a car drives one of {', '.join(COURSES)}")
    made = make_paths(replace(paths, placed=False, mirrored=False, kind=COURSES[name]))
    points = made.points[0, : int(made.count[0])].tolist()
    file = folder / f"{name}.csv"
    lines = path_lines(CarPath(points, bool(made.closed[0]), name))
    write_atomically(file, "\n".join(lines) + "\n")
    return file


def policy_section(policy: str, course: Path, settings: Mapping[str, float]) -> dict[str, Any]:
    """The section `policy` of a config: a file of `scripts/export_policy.py`, or `pursuit`."""
    if policy == "pursuit":
        return {"kind": "pursuit", "path": str(course), **settings}
    return {"kind": "exported", "file": policy, "path": str(course)}


def simulated_config(
    car: SimulatedCarConfig, address: str, policy: Mapping[str, Any], output: str, seconds: float
) -> dict[str, Any]:
    """The config of the runtime on a simulated car, driven by a scripted person.

    Args:
        car: The car.
        address: Where it listens.
        policy: Section of the config.
        output: Folder of the recordings.
        seconds: Of driving [s].
    """
    device = {"kind": "simulated", "address": address}
    # Half of the drive, in each kind of command.
    half = {"throttle_cap": 0.5} if car.two_way else {}
    return {
        "sensor": device,
        "actuator": device,
        "pilot": {"kind": "scripted"},
        "policy": dict(policy),
        "output": output,
        "geofence": "none",
        "safety": {"max_seconds": seconds, **half},
        "two_way": car.two_way,
        "speed": car.speed,
    }


def start_runtime(
    config: Mapping[str, Any], file: Path, output: int | None = None, errors: int | None = None
) -> subprocess.Popen:
    """Starts the runtime in a process of its own, as on the car's computer; from a main thread.

    It stops the car and ends when this process ends, however that does.

    Args:
        config: Of the runtime.
        file: That it is written to.
        output: Where its messages go, as of `subprocess`; None for this process's own.
        errors: Likewise its standard error.
    """
    write_json(file, dict(config))
    command = [sys.executable, "-m", "buggy_rl.car", str(file), str(os.getpid())]
    return subprocess.Popen(command, stdout=output, stderr=errors)
