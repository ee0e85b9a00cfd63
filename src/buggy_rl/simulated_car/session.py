"""A drive of the car's own runtime in the simulated car: files are written, both are started."""

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from buggy_rl.car.path import Path as CarPath
from buggy_rl.car.path import path_lines
from buggy_rl.files import write_atomically, write_json
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.task.paths.making import PathConfig, make_paths

COURSES = {"lap": "lap", "infinity": "infinity", "random": "tight"}
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
