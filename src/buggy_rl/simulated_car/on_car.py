"""What `scripts/drive.py car=...` does: the car's own runtime, on a simulated car or a real one."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

from omegaconf import MISSING

from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.task.paths.making import PathConfig

SIMULATED = "simulated"
PASSED_ON = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


@dataclass(frozen=True)
class OnCarConfig:
    """Which car drives what."""

    car: str = MISSING
    """simulated, or the JSON config of a real car, which then says all the rest."""
    output: str = "runs/car"
    """Folder of the recordings."""
    policy: str = "pursuit"
    """Files of scripts/export_policy.py, named by their .json, or pursuit."""
    course: str = "lap"
    """lap, infinity, random, or a CSV of waypoints."""
    seconds: float = 10.0
    """Driving time [s]."""
    pursuit: dict[str, float] = field(default_factory=dict)
    """Settings of the pursuit, as pursuit.speed=1.5; src/buggy_rl/car/path.py lists them."""
    safety: dict[str, float] = field(default_factory=dict)
    """Limits that differ, as safety.throttle_cap=1; src/buggy_rl/car/safety.py lists them."""
    simulated: SimulatedCarConfig = field(default_factory=SimulatedCarConfig)
    """The simulated car."""
    paths: PathConfig = field(default_factory=PathConfig)
    """Sizes of the courses."""

    def __post_init__(self) -> None:
        if not 0 < self.seconds <= 7200:
            raise ValueError(f"seconds={self.seconds:g}: must be above 0 and at most 7200")
        if self.pursuit and self.policy != "pursuit":
            raise ValueError(f"pursuit={self.pursuit}: policy={self.policy} has no such settings")
        if self.car not in (SIMULATED, MISSING) and replace(self, car=SIMULATED) != SIMPLE:
            raise ValueError(f"car={self.car}: write the other options into that file")


SIMPLE = OnCarConfig(SIMULATED)


def drive_on_car(config: OnCarConfig) -> int:
    """Drives to the end; returns the exit status of the runtime.

    Raises:
        ValueError: The course is unknown.
        OSError: The simulated car does not start.
    """
    if config.car != SIMULATED:
        command = [sys.executable, "-m", "buggy_rl.car", config.car, str(os.getpid())]
        return _finished(subprocess.Popen(command))
    from buggy_rl.simulated_car import launcher as session
    from buggy_rl.simulated_car.launcher import SimulatedCar

    with tempfile.TemporaryDirectory(prefix="buggy_rl_") as scratch:
        folder = Path(scratch)  # beside the recordings a path would be taken for one
        course = Path(config.course)
        if course.suffix != ".csv":
            course = session.write_course(config.course, config.paths, folder)
        policy = session.policy_section(config.policy, course, config.pursuit)
        with SimulatedCar(config.simulated) as car:
            about = session.simulated_config(
                config.simulated, car.address, policy, config.output, config.seconds
            )
            about["safety"] |= config.safety
            return _finished(session.start_runtime(about, folder / "car.json"))


def _finished(runtime: subprocess.Popen) -> int:
    """The exit status. Signals are passed on: the runtime stops the car, and the car is there yet.

    Ctrl-C and a closed terminal reach the runtime by themselves too; a second signal does no harm.
    """

    def pass_on(number: int, _: object) -> None:
        with contextlib.suppress(ProcessLookupError):
            runtime.send_signal(number)

    before = {number: signal.signal(number, pass_on) for number in PASSED_ON}
    try:
        return runtime.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if runtime.poll() is None:
            runtime.terminate()
