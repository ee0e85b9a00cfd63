"""Diagnoses with slow simulators: time against what was promised, by workers and by length.

    python benchmarks/slow_simulators.py
    python benchmarks/slow_simulators.py "simulators=[reference,mujoco]" "workers=[1,2]"
    python benchmarks/slow_simulators.py "simulators=[reference]" "lengths=[15,90,600,2400]"

Two drives of the reference car with a concealed steering dead time; `slow` is that car in float64
with 20 times its steps, `own` in float64 with eight, both as a user's own file. Other makes get two
drives of before the change as baseline. Each measurement runs in a process of its own.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tqdm import tqdm

from buggy_rl.core.config import from_command_line
from diagnosing.job import Config as Drives
from diagnosing.job import Job
from diagnosing.slow_table import table

HERE = Path(__file__).parent
OWN = {"slow": "make", "own": "make_own"}  # factories of diagnosing/slow_car.py
TRUTH = "steering_dead_time"
WHOSE = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)  # memory of this process and its workers


@dataclass(frozen=True)
class Config:
    """What to measure."""

    simulators: list[str] = field(default_factory=lambda: ["slow", "own"])
    """slow, own, or any engine, .yaml, .pt or file.py:factory."""
    workers: list[int] = field(default_factory=lambda: [2])
    """Processes."""
    lengths: list[float] = field(default_factory=lambda: [90.0])
    """Both drives together [s]."""
    minutes: float = 10.0
    """That a diagnosis may take."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


def main() -> None:
    """Measures, prints a table, writes the JSON."""
    if sys.argv[1:2] == ["--one"]:
        print("row", json.dumps(one(**json.loads(sys.argv[2]))), flush=True)
        return
    config = from_command_line(__doc__, "slow_simulators:Config")
    with tempfile.TemporaryDirectory() as folder:
        run("drives", folder=folder, seconds=max(config.lengths))
        jobs = [
            {"folder": folder, "seconds": s, "simulator": n, "workers": w}
            for n in config.simulators
            for s in config.lengths
            for w in config.workers
        ]
        rows = [run("diagnosis", minutes=config.minutes, **job) for job in tqdm(jobs, unit="job")]
    print(table(rows))
    if config.output:
        content = {"cpus": os.cpu_count(), "config": asdict(config), "rows": rows}
        Path(config.output).write_text(json.dumps(content, indent=2) + "\n")


def run(what: str, **asked: Any) -> dict[str, Any]:
    """The row of one measurement, in a process of its own."""
    command = [sys.executable, __file__, "--one", json.dumps({"what": what, **asked})]
    threads = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
    load = os.getloadavg()[0]
    done = subprocess.run(command, env=os.environ | threads, capture_output=True, text=True)
    marked = [line for line in done.stdout.splitlines() if line.startswith("row ")]
    if done.returncode or not marked:
        raise SystemExit(f"error: {asked}: {(done.stderr.strip().splitlines() or ['?'])[-1]}")
    return {**asked, "load": load, **json.loads(marked[-1].removeprefix("row "))}


def one(what: str, folder: str, seconds: float, **asked: Any) -> dict[str, Any]:
    """Makes the drives, or diagnoses them."""
    import torch

    torch.set_num_threads(1)
    if what == "drives":
        from diagnosing.drives import make_drives

        for kind in ("changed", "right"):
            make_drives(Job("drives", kind, folder, Drives(), seconds))
        return {}
    return diagnosed(Job("slow", asked["simulator"], folder, Drives(), seconds), **asked)


def diagnosed(job: Job, simulator: str, workers: int, minutes: float) -> dict[str, Any]:
    """Time, memory and answer of a diagnosis, and the first time that it promised."""
    from buggy_rl.diagnosis.config import DiagnosisConfig
    from buggy_rl.diagnosis.pipeline import run_diagnosis
    from buggy_rl.diagnosis.run.meter import MeterReading
    from diagnosing.drives import load

    own = simulator in (*OWN, "reference")
    file = f"{HERE / 'diagnosing' / 'slow_car.py'}:{OWN[simulator]}" if simulator in OWN else ""
    config = DiagnosisConfig(
        simulator=file or simulator,
        recordings=[""],
        output="",
        parameters=False,
        minutes=minutes,
        workers=workers,
    )
    recordings = load(job.file("changed"), job.seconds)
    baseline = [] if own else load(job.file("right"), job.seconds)
    promised: list[tuple[float, float]] = []
    begin, cpu = time.perf_counter(), os.times()

    def show(reading: MeterReading) -> None:
        promised.append((time.perf_counter() - begin, reading.left))

    answer = run_diagnosis(config, recordings, baseline=baseline, show=show).answer
    end, used = time.perf_counter(), os.times()
    usage = [resource.getrusage(who).ru_maxrss for who in WHOSE]
    return {
        "total": end - begin,
        "cpu": sum(used[:4]) - sum(cpu[:4]),
        "memory_mb": sum(usage) / 1024,
        "promised": sum(promised[0]),
        "promised_at": promised[0][0],
        "halfway": sum(promised[len(promised) // 2]),
        "verdict": answer.verdict,
        "named": [[e.name, e.confidence] for e in answer.effects],
        "right": bool(answer.effects) and answer.effects[0].name == TRUTH,
        "notes": answer.notes,
    }


if __name__ == "__main__":
    main()
