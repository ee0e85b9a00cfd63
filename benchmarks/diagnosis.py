"""Time and memory of a whole diagnosis, and the same parameter by `mujoco.sysid` beside ours.

    python benchmarks/diagnosis.py output=diagnosis.json figure=diagnosis.png
    python benchmarks/diagnosis.py "parts=[speed]" "simulators=[reference,mujoco]" rounds=3
    python benchmarks/diagnosis.py "parts=[sysid]" parameter=mass truth=1.95

speed: two drives of the reference car with a concealed steering dead time, every effect to choose
from. scale: time against the length of the drives and the number of effects.
sysid: a MuJoCo car with one parameter off. Drives are made in the run; each measurement runs in a
process of its own. Run it on a quiet machine.
"""

import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from buggy_rl.core.config import from_command_line
from diagnosing.job import Config, Job, Row
from diagnosing.tables import TOLD, tables

PARTS = ("speed", "scale", "sysid")


def main() -> None:
    """Runs the jobs one after another, prints the tables, writes the JSON and the figure."""
    if sys.argv[1:2] == ["--job"]:
        content = json.loads(sys.argv[2])
        config = Config(**content.pop("config"))
        work(Job(**content, config=config))
        return
    config = from_command_line(__doc__, "diagnosing.job:Config")
    check(config)
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(config, folder)
    print(tables(rows))
    if load > 0.5:
        print(f"\nthe machine was busy when this began: load {load:.1f}")
    if config.output:
        about = {"load_before": load, "cpus": os.cpu_count(), "config": asdict(config)}
        Path(config.output).write_text(json.dumps({**about, "rows": rows}, indent=2) + "\n")
    if config.figure:
        importlib.import_module("diagnosing.figure").draw(rows, config.figure)


def check(config: Config) -> None:
    """Ends with one line where the measurement cannot be made."""
    for what, given, known in (("part", config.parts, PARTS), ("peer", config.peers, TOLD)):
        unknown = sorted(set(given) - set(known))
        if unknown:
            raise SystemExit(f"error: no {what} {', '.join(unknown)}; there are {', '.join(known)}")
    if config.figure and "scale" not in config.parts:
        raise SystemExit("error: figure= draws the curves of scale: add it to parts=")


def measure(config: Config, folder: str) -> list[Row]:
    """Makes drives and model, then the rows of all measurements.

    Raises:
        SystemExit: Drives or model could not be made.
    """
    for job in bar(list(preparations(config, folder)), "preparing"):
        done = run(job)
        if "failed" in done:
            raise SystemExit(f"error: {job.kind} {job.name}: {done['failed']}")
    jobs = [job for _ in range(config.rounds) for job in measurements(config, folder)]
    return [run(job) for job in bar(jobs, "measuring")]


def preparations(config: Config, folder: str) -> Iterator[Job]:
    """What is driven and learned before the clock starts."""
    both = 2 * config.seconds
    if "speed" in config.parts or "scale" in config.parts:
        longest = max([both, *config.lengths]) if "scale" in config.parts else both
        yield Job("drives", "changed", folder, config, longest)
        if others_than_reference(config):
            scaled = not config.scale_simulator.startswith("reference")
            yield Job("drives", "right", folder, config, longest if scaled else both)
    if "speed" in config.parts and "learned" in config.simulators and not config.model:
        yield Job("drives", "lessons", folder, config, both)
        yield Job("model", "learned", folder, config)
    if "sysid" in config.parts:
        yield Job("drives", "off", folder, config, both)


def others_than_reference(config: Config) -> bool:
    """Whether a simulator is another car than the one that was driven: it gets baseline drives."""
    names = config.simulators if "speed" in config.parts else []
    names = [*names, config.scale_simulator] if "scale" in config.parts else names
    return any(not name.startswith("reference") for name in names)


def measurements(config: Config, folder: str) -> Iterator[Job]:
    """Every measurement once."""
    both = 2 * config.seconds
    if "speed" in config.parts:
        yield from (Job("speed", name, folder, config, both) for name in config.simulators)
    if "scale" in config.parts:
        name, most = config.scale_simulator, max(config.candidates)
        yield from (Job("length", name, folder, config, s, most) for s in config.lengths)
        yield from (Job("candidates", name, folder, config, both, n) for n in config.candidates)
    if "sysid" in config.parts:
        yield from (Job("peer", name, folder, config, both) for name in config.peers)


def bar(jobs: list[Job], what: str) -> Iterable[Job]:
    """Shows which job is under way."""
    with tqdm(jobs, what, unit="process") as shown:
        for job in shown:
            detail = f"{job.candidates} candidates" if job.candidates else f"{job.seconds:g} s"
            shown.set_postfix_str(f"{job.kind} {job.name}, {detail}")
            yield job


def run(job: Job) -> Row:
    """The row of a job, or one that says why there is none."""
    threads = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
    command = [sys.executable, __file__, "--job", json.dumps(asdict(job))]
    result = subprocess.run(command, env=os.environ | threads, capture_output=True, text=True)
    marked = [line for line in result.stdout.splitlines() if line.startswith("row ")]
    about = {"kind": job.kind, "name": job.name, "asked": job.candidates}
    about |= {"total_seconds": job.seconds, "threads": job.config.threads}
    if job.kind == "peer":
        about |= {"parameter": job.config.parameter, "truth": job.config.truth}
    if result.returncode or not marked:
        last = (result.stderr.strip().splitlines() or ["no message"])[-1]
        return {**about, "failed": last}
    return {**about, **json.loads(marked[-1].removeprefix("row "))}


def work(job: Job) -> None:
    """Does a job in this process and prints one line of JSON."""
    import torch

    torch.set_num_threads(1)
    row: dict[str, Any] = worker(job)(job) or {}
    row["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print("row", json.dumps(row), flush=True)


def worker(job: Job) -> Any:
    """What does a job; a process imports no more than it needs."""
    module, name = {
        "drives": ("drives", "make_drives"),
        "model": ("drives", "make_model_file"),
        "speed": ("diagnosed", "diagnosis_row"),
        "length": ("diagnosed", "diagnosis_row"),
        "candidates": ("diagnosed", "diagnosis_row"),
        "peer": ("peers", "peer_row"),
    }[job.kind]
    if (job.kind, job.name) == ("peer", "diagnosis"):
        module, name = "diagnosed", "own_parameter_row"
    return getattr(importlib.import_module(f"diagnosing.{module}"), name)


if __name__ == "__main__":
    main()
