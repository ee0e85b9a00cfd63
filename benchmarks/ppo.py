"""Training speed: ours against stable-baselines3, whole training loops on the same cars.

    python benchmarks/ppo.py output=ppo.json
    python benchmarks/ppo.py score=true "simulators=[runs/sample/models/history_mlp__raw.pt]"
    python benchmarks/ppo.py profile=true "threads=[1]" "cases=[]"

Three cases: `original`, stable-baselines3 as the original study used it (one Gymnasium
environment, its settings); `batched`, stable-baselines3 over our batch of cars as a `VecEnv` with
our settings; `ours`. Each is measured in a process of its own, because threads must be set before
torch loads. Run it on a quiet machine.
"""

import importlib.util
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from buggy_rl.core.config import from_command_line
from training.tables import tables

SHARE = 0.8  # of the tuned pure pursuit's waypoints that a policy has to reach
CANDIDATES = 64  # sets of numbers that the pursuit's search tries at once, in each of its rounds


@dataclass(frozen=True)
class Config:
    """What to measure."""

    simulators: list[str] = field(default_factory=lambda: ["learned", "mujoco"])
    """An engine's name (learned: an untrained history MLP, for speed alone), a .pt or a .yaml."""
    cases: list[str] = field(default_factory=lambda: ["original", "batched", "ours"])
    """Trainings to compare."""
    threads: list[int] = field(default_factory=lambda: [1, 2])
    """Threads of torch, and of MuJoCo's batch."""
    rounds: int = 2
    """How often the cases take turns, each time in new processes; 0 measures no speed."""
    repeats: int = 3
    """Measurements in a process; what is reported is the median over all rounds."""
    seconds: float = 4.0
    """Shortest length of one measurement; it is of whole batches."""
    score: bool = False
    """Also the wall time of each case to 80 % of the best tuned pure pursuit's waypoints."""
    every: int = 100_000
    """Steps between two looks at a policy, on the validation paths and outside of the clock."""
    limit: float = 1200.0
    """Seconds of training after which a case is given up."""
    profile: bool = False
    """Also where the time of ours goes, and the floor under it."""
    ours: list[str] = field(default_factory=lambda: ["configs/ppo.yaml"])
    """Settings of `ours` and `batched`: YAML files and key=value overrides."""
    original: list[str] = field(default_factory=lambda: ["configs/ppo_original.yaml"])
    """Settings of `original`."""
    seed: int = 0
    """Of weights, starts, exploration, minibatches and the pursuit's search."""
    output: str = ""
    """JSON file for the figures; empty writes none."""


@dataclass(frozen=True)
class Job:
    """What one process measures."""

    kind: str
    """speed, pursuit, score or profile."""
    simulator: str
    threads: int
    case: str
    config: Config
    target: float = 0.0
    """Waypoints to reach, of a score."""


def main() -> None:
    """Runs the jobs one after another, prints the tables and writes the JSON."""
    if sys.argv[1:2] == ["--job"]:
        content = json.loads(sys.argv[2])
        config = Config(**content.pop("config"))
        work(Job(**content, config=config))
        return
    config = from_command_line(__doc__, "ppo:Config")
    check(config)
    load = os.getloadavg()[0]
    rows = measure(config)
    print(tables(rows))
    if load > 0.5:
        print(f"\nthe machine was busy when this began: load {load:.1f}")
    if config.output:
        about = {"load_before": load, "cpus": os.cpu_count(), "config": asdict(config)}
        Path(config.output).write_text(json.dumps({**about, "rows": rows}, indent=2) + "\n")


def check(config: Config) -> None:
    """Ends with one line where the measurement cannot be made."""
    if importlib.util.find_spec("stable_baselines3") is None:
        raise SystemExit("error: stable-baselines3 is not installed: pip install -e '.[peers]'")
    unknown = sorted(set(config.cases) - {"original", "batched", "ours"})
    if unknown:
        raise SystemExit(f"error: no case {', '.join(unknown)}; original, batched, ours")
    if config.score and "learned" in config.simulators:
        raise SystemExit(
            "error: score=true needs a trained model: simulators=[path/to/model.pt,mujoco]"
        )


def measure(config: Config) -> list[dict[str, Any]]:
    """The rows of all jobs; speeds first, so that nothing else has warmed the machine."""
    speeds = [job for _ in range(config.rounds) for job in jobs("speed", config, config.cases)]
    rows = [run(job) for job in bar(speeds)]
    if config.profile:
        rows += [run(job) for job in bar(list(jobs("profile", config, ["ours"])))]
    if config.score:
        most = replace(config, threads=[max(config.threads)])  # the score itself has no threads
        pursuits = [run(job) for job in bar(list(jobs("pursuit", most, ["pure pursuit"])))]
        targets = {p["simulator"]: SHARE * p["waypoints"] for p in pursuits if "failed" not in p}
        climbs = [
            replace(job, target=targets[job.simulator])
            for job in jobs("score", config, config.cases)
            if job.simulator in targets
        ]
        rows += pursuits + [run(job) for job in bar(climbs)]
    return rows


def jobs(kind: str, config: Config, cases: Sequence[str]) -> Iterator[Job]:
    """Every process to start; cases that are compared come one right after another."""
    for simulator in config.simulators:
        for threads in config.threads:
            for case in cases:
                yield Job(kind, simulator, threads, case, config)


def bar(todo: Sequence[Job]) -> Iterable[Job]:
    """The jobs, with a progress bar that says which one runs."""
    shown = tqdm(todo, unit="process")
    for job in shown:
        where = Path(job.simulator).name
        shown.set_description(f"{job.kind}: {job.case}, {where}, {job.threads} threads")
        yield job


def run(job: Job) -> dict[str, Any]:
    """The row of a job, or one that says why there is none."""
    threads = {"OMP_NUM_THREADS": str(job.threads), "OMP_WAIT_POLICY": "PASSIVE"}
    command = [sys.executable, __file__, "--job", json.dumps(asdict(job))]
    result = subprocess.run(command, env=os.environ | threads, capture_output=True, text=True)
    about = {"kind": job.kind, "simulator": job.simulator, "threads": job.threads}
    about["case"] = job.case
    for line in result.stdout.splitlines():
        if line.startswith("row "):
            return {**about, **json.loads(line.removeprefix("row "))}
    return {**about, "failed": (result.stderr.strip().splitlines() or ["no message"])[-1]}


def work(job: Job) -> None:
    """Measures in this process and prints one line of JSON."""
    import torch

    torch.set_num_threads(job.threads)
    found = {"speed": speed, "pursuit": pursuit, "score": climb, "profile": profile}[job.kind](job)
    found["peak_memory_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print("row", json.dumps(found), flush=True)


def training(job: Job, endless: bool) -> Any:
    """The case of a job, at its beginning."""
    from training.cases import CASES, ENDLESS, read_settings

    c = job.config
    sources = c.original if job.case == "original" else c.ours
    endless = endless or job.case == "original"  # it is slow, not short: only the clock ends it
    settings = read_settings([*sources, *([f"ppo.steps={ENDLESS}"] if endless else [])], c.seed)
    return CASES[job.case](job.simulator, job.threads, settings)


def speed(job: Job) -> dict[str, Any]:
    """Steps a second of the whole loop."""
    from training.timing import rates

    found, per_cpu_second = rates(training(job, True), job.config.seconds, job.config.repeats)
    return {"rates": found, "per_cpu_second": per_cpu_second}


def pursuit(job: Job) -> dict[str, Any]:
    """What the best tuned pure pursuit closes on the validation paths."""
    from training.score import tuned_pursuit

    return tuned_pursuit(job.simulator, job.threads, job.config.ours, CANDIDATES, job.config.seed)


def climb(job: Job) -> dict[str, Any]:
    """Wall time to the score."""
    from training.cases import read_settings
    from training.score import climb

    c = job.config
    run = read_settings(c.ours, c.seed)  # all are judged on the same task
    found = climb(training(job, False), job.simulator, run, job.target, c.every, c.limit)
    return {"target": job.target, **asdict(found)}


def profile(job: Job) -> dict[str, Any]:
    """Where the time of ours goes."""
    from training.breakdown import breakdown
    from training.floor import floor

    found = training(job, True)
    return {
        "parts": breakdown(found, job.config.seconds),
        "floor": floor(found, job.config.seconds),
    }


if __name__ == "__main__":
    main()
