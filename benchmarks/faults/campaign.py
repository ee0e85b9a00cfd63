"""Injects faults into drives of the simulated car, again and again, and keeps a line of each."""

import csv
import json
import random
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np
import pandas as pd
from tqdm import tqdm

from buggy_rl.car.interfaces import NO_DRIVE
from buggy_rl.car.recorder import COLUMNS
from buggy_rl.recordings import RecordingError
from buggy_rl.recordings.loading import load_recording
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.launcher import SimulatedCar
from buggy_rl.simulated_car.session import (
    policy_section,
    simulated_config,
    start_runtime,
    write_course,
)
from buggy_rl.task.paths.making import PathConfig
from buggy_rl.vehicle import CONTROL_PERIOD
from faults.injection import ENDS, FAULTS, WATCHED, Reaction, Target, reaction

HARDWARE = {"watchdog_killed": 0.1}
"""Fault -> failsafe of the simulated board [s], for faults that only hardware can answer."""
SLOWEST_START = 30.0  # [s] until the car drives
DELAY = (0.15, 0.7)  # [s] of driving before a fault
DELAYS = {
    "jumping": (1.5, 3.0),  # or a third of the recording is elsewhere, which a reader refuses
    **dict.fromkeys(ENDS, (1.0, 1.6)),  # it ends the drive, and a recording has 1 s or more
}
ROUNDING = 2e-6  # [s] of stamps in a recording, which are written in microseconds
CELLS = len(COLUMNS) - 1  # commas of a whole line
SLOWEST_END = 10.0  # [s] of the runtime
A_DRIVE = 20  # injections in one drive, if the runtime survives them


@dataclass(frozen=True)
class CampaignConfig:
    """What is injected, and how often."""

    output: str = "benchmarks/results/car_faults.csv"
    """A line for each injection; those that are there are kept and counted."""
    work: str = "runs/car_faults"
    """Folder of the drives' recordings."""
    faults: list[str] = field(default_factory=lambda: list(FAULTS))
    """Some of them."""
    times: int = 100
    """Of each."""
    seed: int = 0
    """Of the moments and sizes."""
    car: SimulatedCarConfig = field(default_factory=lambda: SimulatedCarConfig(compiled=True))

    def __post_init__(self) -> None:
        unknown = sorted(set(self.faults) - set(FAULTS))
        if unknown:
            raise ValueError(f"unknown faults {unknown}; available: {', '.join(FAULTS)}")


@dataclass(frozen=True)
class Injection:
    """One line of the result."""

    fault: str
    number: int
    cut_ms: float
    """Until the wheels got no drive."""
    neutral_ms: float
    """Until they were straight as well."""
    readable: bool
    """The recording of its drive loads."""
    missing_s: float
    """Readings that arrived as measured and are not in the recording."""


def left(config: CampaignConfig) -> Counter:
    """How many injections of each fault are still to be made."""
    made: Counter = Counter()
    if Path(config.output).exists():
        with Path(config.output).open() as stream:
            made.update(row["fault"] for row in csv.DictReader(stream))
    return Counter({name: max(0, config.times - made[name]) for name in config.faults})


def injections(config: CampaignConfig) -> Iterator[Injection]:
    """Makes what is left; yields each injection once it is in the file."""
    for fault, count in left(config).items():
        if not count:
            continue
        car = SimulatedCarConfig(
            **{**vars(config.car), "failsafe": HARDWARE.get(fault, config.car.failsafe)}
        )
        with SimulatedCar(car) as running:
            yield from _of_fault(config, running, fault, count)


def _of_fault(
    config: CampaignConfig, car: SimulatedCar, fault: str, count: int
) -> Iterator[Injection]:
    a_drive = 1 if fault in ENDS else A_DRIVE
    number = config.times - count
    while number < config.times:
        chance = random.Random(f"{config.seed} {fault} {number}")
        wanted = min(a_drive, config.times - number)
        for found in _drive(config, car, fault, number, wanted, chance):
            _append(Path(config.output), found)
            number += 1
            yield found


def _drive(
    config: CampaignConfig,
    car: SimulatedCar,
    fault: str,
    number: int,
    wanted: int,
    chance: random.Random,
) -> list[Injection]:
    """One drive with so many injections."""
    work = Path(config.work)
    work.mkdir(parents=True, exist_ok=True)
    course = write_course("lap", PathConfig(), work)
    policy = policy_section("pursuit", course, {"speed": 1.0})
    content = simulated_config(config.car, car.address, policy, str(work / "rec"), 3600.0)
    content["pilot"] = {"kind": "scripted", "press_after": 0.25, "again": True}
    before = set((work / "rec").glob("*.csv"))
    begin = car.now
    runtime = start_runtime(content, work / "car.json", subprocess.DEVNULL)
    try:
        target = Target(car, runtime, chance)
        measured = [_inject(target, fault) for _ in range(wanted)]
        end = measured[-1].begin if fault in ENDS else car.now
    finally:
        if fault not in ENDS:
            runtime.send_signal(signal.SIGTERM)
        runtime.wait(SLOWEST_END)
    recording = next(iter(set((work / "rec").glob("*.csv")) - before))
    readable = _loads(recording)
    missing = missing_time(recording, [s for s in car.sent(begin) if s < end])
    return [
        Injection(fault, number + index, found.cut, found.neutral, readable, missing)
        for index, found in enumerate(measured)
    ]


def _inject(target: Target, fault: str) -> Reaction:
    """Waits until the car drives, spoils it at a random moment, reads the wheels' log [ms]."""
    while True:
        _wait_for_drive(target)
        time.sleep(target.chance.uniform(*DELAYS.get(fault, DELAY)))
        earlier = target.car.now
        if target.car.wheels(earlier)[0][1] <= NO_DRIVE:
            continue  # it coasts just now: nothing could be cut
        begin = FAULTS[fault](target)
        time.sleep(max(0.0, begin + WATCHED - target.car.now))
        return reaction(begin, target.car.wheels(begin))


def _wait_for_drive(target: Target) -> None:
    end = time.monotonic() + SLOWEST_START
    while target.car.wheels(target.car.now)[0][1] <= NO_DRIVE:
        if time.monotonic() > end or target.runtime.poll() is not None:
            raise RuntimeError("the car does not drive: start the runtime by hand and see why")
        time.sleep(0.02)


def _loads(recording: Path) -> bool:
    try:
        load_recording(recording)
    except RecordingError as error:
        tqdm.write(str(error))
        return False
    return True


def missing_time(recording: Path, sent: list[float]) -> float:
    """Time [s] of the readings that arrived, from the first recorded one on, and are in no row."""
    origin = json.loads(recording.with_suffix(".json").read_text())["origin"]
    lines = recording.read_text().splitlines()[1:]
    rows = np.array([float(line.split(",", 1)[0]) for line in lines if line.count(",") == CELLS])
    arrived = np.array([stamp - origin for stamp in sent])
    arrived = arrived[arrived > rows[0] - ROUNDING]
    after = np.clip(np.searchsorted(rows, arrived), 1, len(rows) - 1)
    nearest = np.minimum(np.abs(rows[after] - arrived), np.abs(rows[after - 1] - arrived))
    return CONTROL_PERIOD * float((nearest > ROUNDING).sum())


def _append(file: Path, found: Injection) -> None:
    """Adds a line; the file is made with its header."""
    file.parent.mkdir(parents=True, exist_ok=True)
    new = not file.exists()
    with file.open("a", newline="") as stream:
        writer = csv.DictWriter(stream, [f.name for f in fields(Injection)])
        if new:
            writer.writeheader()
        values = asdict(found)
        writer.writerow({k: round(v, 2) if isinstance(v, float) else v for k, v in values.items()})


def summary(file: Path) -> list[str]:
    """A table of the file: a row for each fault."""
    table = pd.read_csv(file)
    lines = [
        "| fault | n | no drive, p50 [ms] | p99 | max | wheels straight, p50 [ms] | p99 | max | "
        "readable | missing, max [s] |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for fault, rows in table.groupby("fault", sort=False):
        cells = [str(fault), str(len(rows))]
        for column in ("cut_ms", "neutral_ms"):
            cells += [f"{v:.0f}" for v in np.quantile(rows[column], [0.5, 0.99, 1.0])]
        cells += [str(np.sum(rows["readable"])), f"{np.max(rows['missing_s']):.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return lines
