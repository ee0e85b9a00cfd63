"""Scaling of independent jobs: 1 and 2 workers here, and a model of more machines.

    python benchmarks/scale.py output=runs/scale
    python benchmarks/scale.py output=runs/scale "launchers=[local,ray]" seeds=8 cases=4

Trains `seeds` small policies and diagnoses `cases` sealed cases with each number of workers, checks
that every run wrote the same results, and measures what a job costs beside its work: bytes through
the launcher, seconds to start, seconds of the driver. Writes OUTPUT/scale.csv, overheads.csv,
model.csv; the load of the machine stands in each row.
"""

import os
import subprocess
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from buggy_rl.core.config import from_command_line, run
from buggy_rl.jobs import Launching
from scaling.model import Costs, Work, efficiency, most_workers, needed, wall
from scaling.overheads import overheads, seconds_of, written

ROOT = Path(__file__).parents[1]
OPTIONS: dict[str, dict[str, Any]] = {"local": {}, "ray": {}, "submitit": {"cluster": "local"}}
TRAIN = (
    "configs/ppo.yaml", "engine.simulator=single_track", "ppo.cars=64", "validations=1",
    "validation_steps=100",
)  # fmt: skip
PROVE = (
    "draw.families=[one]", "draw.seconds=[12.0]", "draw.pairings=[reference]",
    "draw.nuisances=[white]", "draw.driving=[rich]", "draw.names=[steering_gain,gyro_bias]",
    "stretches=10", "effects=[steering_gain,gyro_bias]", "stages=[prepare,seal,ask]",
)  # fmt: skip
DISK = 100e6  # [bytes/s] assumed: a shared disk over gigabit Ethernet
CAR_SECONDS = 600.0  # [s] of a core: diagnose.py's default limit of 10 minutes
CAR_BYTES = 26e6  # [bytes] an hour at 100 Hz; data/sample/sample_00.csv has 72 bytes a row
CASE_SECONDS = 103.0  # [s] a diagnosis of two drives, median of 200 cases of configs/proof.yaml
CASE_BYTES = 1e6  # [bytes] assumed: two drives of 45 s are 0.65 MB; the report
DAY = 86400.0  # [s]


@dataclass(frozen=True)
class Config:
    """What to measure."""

    output: str = MISSING
    """Folder for the runs and the tables."""
    launchers: list[str] = field(default_factory=lambda: ["local"])
    """That run the jobs."""
    workers: list[int] = field(default_factory=lambda: [1, 2])
    """At a time."""
    seeds: int = 8
    """Trainings."""
    steps: int = 65_536
    """Of each."""
    cases: int = 4
    """Sealed cases; 0 for none."""
    empty: int = 20
    """Jobs that do nothing, to measure the overheads."""


def main() -> None:
    """Measures and writes three tables."""
    config = from_command_line(__doc__, "scale:Config")

    import pandas as pd

    folder = Path(config.output)
    overheads = [asdict(overhead(config, name)) for name in config.launchers]
    costs = pd.DataFrame(overheads)
    costs.to_csv(folder / "overheads.csv", index=False)
    print(costs.to_string(index=False), flush=True)
    rows = [
        row for what in ("seeds", "cases") if getattr(config, what) for row in scaled(config, what)
    ]
    table = pd.DataFrame(rows)
    table.to_csv(folder / "scale.csv", index=False)
    print(table.to_string(index=False), flush=True)
    model = pd.DataFrame(modelled(rows, overheads))
    model.to_csv(folder / "model.csv", index=False)
    print(f"{model.to_string(index=False)}\nwritten: {folder}/scale.csv, overheads.csv, model.csv")


def overhead(config: Config, name: str):
    """What a launcher costs beside the work."""
    kind: Any = name
    launching = Launching(launcher=kind, cluster=OPTIONS[name], cores=1)
    return overheads(launching, Path(config.output) / f"empty_{name}", config.empty)


def scaled(config: Config, what: str) -> list[dict[str, Any]]:
    """A row for each launcher and number of workers."""
    rows: list[dict[str, Any]] = []
    results = set()
    for name in config.launchers:
        for workers in config.workers:
            place = Path(config.output) / what / f"{name}_{workers}"
            load, seconds = os.getloadavg()[0], ran(config, what, place, name, workers)
            own = f"{'seed_*' if what == 'seeds' else 'answers/*'}"
            folders = sorted((place / "out").glob(own))
            results.add(contents(folders))
            files, size = written(folders)
            about = {"what": what, "jobs": len(folders), "launcher": name, "workers": workers}
            row = {**about, "seconds": seconds, "job_seconds": seconds_of(folders)}
            rows.append({**row, "files": files, "bytes": size, "load_before": round(load, 1)})
    for row in rows:
        one = next(r for r in rows if r["launcher"] == row["launcher"])
        row["speed_up"] = one["seconds"] * one["workers"] / row["seconds"]
        row["efficiency"] = row["speed_up"] / row["workers"]
        row["same_results"] = len(results) == 1
    return rows


def ran(config: Config, what: str, place: Path, name: str, workers: int) -> float:
    """Runs a script to its end in a folder of its own; seconds."""
    place.mkdir(parents=True)
    for shared in ("configs", "scripts", "data"):
        (place / shared).symlink_to(ROOT / shared)
    launch = [f"launcher={name}", f"workers={workers}", "cores=1", "output=out"]
    launch += [f"cluster.{key}={value}" for key, value in OPTIONS[name].items()]
    seeds = [*TRAIN, f"ppo.steps={config.steps}", f"seeds={list(range(config.seeds))}"]
    script, own = {
        "seeds": ("scripts/train_policy.py", [text.replace(" ", "") for text in seeds]),
        "cases": ("scripts/prove.py", [*PROVE, f"draw.cases={config.cases}"]),
    }[what]
    begun = time.perf_counter()
    with open(place / "log.txt", "w") as log:
        subprocess.run([sys.executable, script, *own, *launch], cwd=place, check=True, stderr=log)
    return time.perf_counter() - begun


def contents(folders: list[Path]) -> tuple[bytes, ...]:
    """What must not depend on launcher or workers."""
    names = ("best.pt", "last.pt", "checkpoint.pt", "diagnosis.json")
    files = [folder / name for folder in folders for name in names]
    return tuple(file.read_bytes() for file in files if file.exists())


def modelled(rows: list[dict[str, Any]], costs: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of the model, by the measured costs of the launcher whose driver takes longest."""
    own = max(costs, key=lambda each: each["driver_seconds"])
    beside = Costs(own["cluster_seconds"], own["import_seconds"], own["driver_seconds"], DISK)
    alone = {row["what"]: row for row in rows if row["workers"] == 1}
    works = [Work("a fleet: recordings of 1,000 cars a day", 1000, CAR_SECONDS, CAR_BYTES)]
    if case := alone.get("cases"):
        seconds = max(0.0, case["job_seconds"] - beside.start)
        works.append(Work("10,000 cases as small as these", 10_000, seconds, case["bytes"]))
    works.append(Work("10,000 cases of configs/proof.yaml", 10_000, CASE_SECONDS, CASE_BYTES))
    return [
        {
            "work": work.name,
            "workers": workers,
            "hours": wall(work, beside, workers) / 3600,
            "efficiency": efficiency(work, beside, workers),
            "most_workers": most_workers(work, beside),
            "workers_for_a_day": needed(work, beside, DAY),
        }
        for work in works
        for workers in (1, 2, 16, 128, 1024)
    ]


if __name__ == "__main__":
    run(main)
