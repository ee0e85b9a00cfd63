"""The control loop against the simulated car, in real time: missed deadlines and times of a step.

    python benchmarks/car_loop.py
    python benchmarks/car_loop.py seconds=60 policy=runs/x/car/policy.json output=runs/car_loop.json

Runs the car's own runtime in a process of its own, at 100 Hz, on the lap. Let nothing else run.
"""

import json
import os
from dataclasses import dataclass, field
from pathlib import Path

from buggy_rl.core.config import from_command_line, run
from buggy_rl.core.files import write_json
from buggy_rl.simulated_car.config import SimulatedCarConfig

TARGET = 0.001  # share of deadlines that may be missed on a quiet machine


@dataclass(frozen=True)
class LoopConfig:
    """One drive."""

    seconds: float = 600.0
    """Of driving [s]."""
    policy: str = "pursuit"
    """Files of scripts/export_policy.py, named by their .json, or pursuit."""
    work: str = "runs/car_loop"
    """Folder of the recording."""
    output: str = ""
    """JSON of the figures; empty for none."""
    simulated: SimulatedCarConfig = field(default_factory=lambda: SimulatedCarConfig(compiled=True))
    """The car."""


def main() -> None:
    """Drives and prints the figures beside their target."""
    config = from_command_line(__doc__, "car_loop:LoopConfig")

    from buggy_rl.simulated_car.on_car import OnCarConfig, drive_on_car

    load = os.getloadavg()[0]
    drive = OnCarConfig(
        "simulated", config.work, config.policy, seconds=config.seconds, simulated=config.simulated
    )
    status = drive_on_car(drive)
    note = json.loads(max(Path(config.work).glob("drive_*.json"), key=os.path.getmtime).read_text())
    share = note["missed"] / note["steps"]
    print(f"load before {load:.2f}; {share:.4%} missed, target below {TARGET:.1%}: ", end="")
    print("met" if status == 0 and share < TARGET else "NOT MET")
    if config.output:
        write_json(Path(config.output), {**note, "load": load, "missed_share": share})


if __name__ == "__main__":
    run(main)
