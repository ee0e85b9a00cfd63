"""Injects faults into drives of the simulated car, again and again, and keeps a line of each."""

import csv
import json
import os
import queue
import random
import signal
import subprocess
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

import numpy as np
from tqdm import tqdm

from buggy_rl.car.interfaces import NO_DRIVE
from buggy_rl.car.recorder import COLUMNS
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.recordings import RecordingError
from buggy_rl.recordings.loading import load_recording
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.launcher import (
    SimulatedCar,
    policy_section,
    simulated_config,
    start_runtime,
    write_course,
)
from buggy_rl.task.paths.making import PathConfig
from faults.devices import HERE, IN_LOOP, IN_WATCHDOG, spoil
from faults.injection import ENDS, FAULTS, TALKING, WATCHED, Reaction, Target, reaction
from faults.table import summary as summary

SLOWEST_START = 30.0  # [s] until the car drives
DELAY = (0.15, 0.7)  # [s] of driving before a fault
DELAYS = {
    "jumping": (1.5, 3.0),  # or a third of the recording is elsewhere, which a reader refuses
    **dict.fromkeys(ENDS, (0.8, 1.2)),  # it ends the drive, and a recording has 1 s or more
    "velocity_frozen": (0.4, 0.9),  # it is learnt first that the velocity does not repeat
    "pose_drifting": (1.0, 2.0),
}
WATCHES = {"pose_drifting": 0.9}  # [s]
ROUNDING = 2e-6  # [s] of stamps in a recording, which are written in microseconds
CELLS = len(COLUMNS) - 1  # commas of a whole line
SLOWEST_END = 10.0  # [s] of the runtime
WHERE = {"actuator": "watchdog", "sensor": "loop"}
"""Section of the config -> the process that its driver runs in."""
TRIES = 10  # of a fault's drives that end before the fault: a busy machine stops the car as well
HUNG = ("loop_hangs",)  # it is killed afterwards
A_DRIVE = 20  # injections in one drive, if the runtime survives them


class NotDrivenError(RuntimeError):
    """The drive ended before the fault."""


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
    jobs: int = 1
    """Cars that are driven side by side; each keeps a third of a core busy."""
    pages: list[str] = field(default_factory=list)
    """Files whose table between `<!-- car_faults: begin -->` and `end` is written anew."""
    car: SimulatedCarConfig = field(default_factory=lambda: SimulatedCarConfig(compiled=True))

    def __post_init__(self) -> None:
        unknown = sorted(set(self.faults) - set(FAULTS))
        if self.jobs < 1:
            raise ValueError(f"jobs={self.jobs}: must be 1 or above")
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
    """Makes what is left; yields each injection once it is in the file.

    Raises:
        Exception: What ended one of the jobs.
    """
    # Where the runtime finds the spoilt drivers.
    here = str(Path(__file__).parents[1])
    os.environ["PYTHONPATH"] = os.pathsep.join([here, os.environ.get("PYTHONPATH", "")])
    found: queue.Queue[Injection | Exception | None] = queue.Queue()
    waiting: queue.Queue[tuple[str, int]] = queue.Queue()
    for fault, count in left(config).items():
        if count:
            waiting.put((fault, count))
    running = min(config.jobs, waiting.qsize())
    for index in range(running):
        arguments = (config, str(index), waiting, found)
        threading.Thread(target=_job, args=arguments, daemon=True).start()
    while running:
        made = found.get()
        if isinstance(made, Exception):
            raise made
        if made is None:
            running -= 1
        else:
            _append(Path(config.output), made)
            yield made


def _job(config: CampaignConfig, name: str, waiting: queue.Queue, found: queue.Queue) -> None:
    """Drives one car until no fault is left; ends with None, or with what went wrong."""
    try:
        with SimulatedCar(config.car) as car:
            while True:
                try:
                    fault, count = waiting.get_nowait()
                except queue.Empty:
                    break
                _of_fault(Path(config.work) / name, config, car, fault, count, found)
    except Exception as error:
        found.put(error)
    found.put(None)


def _of_fault(
    work: Path,
    config: CampaignConfig,
    car: SimulatedCar,
    fault: str,
    count: int,
    found: queue.Queue,
) -> None:
    a_drive = 1 if fault in ENDS else A_DRIVE
    number, tries = config.times - count, 0
    while number < config.times:
        chance = random.Random(f"{config.seed} {fault} {number}")
        wanted = min(a_drive, config.times - number)
        try:
            made = _drive(work, config, car, fault, number, wanted, chance)
        except NotDrivenError as error:
            tries += 1
            tqdm.write(f"{fault}, number {number}: {error}; once more")
            if tries > TRIES:
                raise
            continue
        for each in made:
            found.put(each)
            number += 1


def _drive(
    work: Path,
    config: CampaignConfig,
    car: SimulatedCar,
    fault: str,
    number: int,
    wanted: int,
    chance: random.Random,
) -> list[Injection]:
    """One drive with so many injections."""
    work.mkdir(parents=True, exist_ok=True)
    before = set((work / "rec").glob("*.csv"))
    begin = car.now
    runtime = _started(work, config, car, fault)
    try:
        target = Target(car, runtime, chance)
        measured = [_inject(target, fault) for _ in range(wanted)]
        end = measured[-1].begin if fault in ENDS else car.now
    finally:
        _end(runtime, fault)
    recording = next(iter(set((work / "rec").glob("*.csv")) - before))
    readable = _loads(recording)
    missing = missing_time(recording, [s for s in car.sent(begin) if s < end])
    return [
        Injection(fault, number + index, found.cut, found.neutral, readable, missing)
        for index, found in enumerate(measured)
    ]


def _started(work: Path, config: CampaignConfig, car: SimulatedCar, fault: str) -> subprocess.Popen:
    """The runtime; nobody reads what it says, where that is the fault."""
    course = write_course("lap", PathConfig(), work)
    policy = policy_section("pursuit", course, {"speed": 1.0})
    content = simulated_config(config.car, car.address, policy, str(work / "rec"), 3600.0)
    content["pilot"] = {"kind": "scripted", "press_after": 0.25, "again": True}
    for place, kinds in (("actuator", IN_WATCHDOG), ("sensor", IN_LOOP)):
        if fault in kinds:
            spoil(f"{car.address}.{WHERE[place]}", "")
            content[place] = {**content[place], "kind": f"{HERE}:Spoilt{place.title()}"}
    output = subprocess.PIPE if fault in TALKING else subprocess.DEVNULL
    return start_runtime(content, work / "car.json", output, output)


def _end(runtime: subprocess.Popen, fault: str) -> None:
    """Ends the drive, if it goes on."""
    if runtime.poll() is None and fault in HUNG:
        runtime.kill()
    if runtime.poll() is None:
        runtime.send_signal(signal.SIGTERM)
    try:
        runtime.wait(SLOWEST_END)
    except subprocess.TimeoutExpired:
        runtime.kill()
        raise
    finally:
        for pipe in (runtime.stdout, runtime.stderr):
            if pipe is not None:
                pipe.close()


def _inject(target: Target, fault: str) -> Reaction:
    """Waits until the car drives, spoils it at a random moment, reads the wheels' log [ms]."""
    while True:
        _wait_for_drive(target)
        time.sleep(target.chance.uniform(*DELAYS.get(fault, DELAY)))
        earlier = target.car.now
        if target.car.wheels(earlier)[0][1] <= NO_DRIVE:
            continue  # it coasts just now: nothing could be cut
        begin = FAULTS[fault](target)
        time.sleep(max(0.0, begin + WATCHES.get(fault, WATCHED) - target.car.now))
        return reaction(begin, target.car.wheels(begin))


def _wait_for_drive(target: Target) -> None:
    end = time.monotonic() + SLOWEST_START
    while target.car.wheels(target.car.now)[0][1] <= NO_DRIVE:
        if time.monotonic() > end or target.runtime.poll() is not None:
            raise NotDrivenError("the car does not drive: its note in `work` says why")
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
