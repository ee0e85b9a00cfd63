"""Policies by the gradient of the reward beside PPO: waypoints after so many seconds of one core.

    python -m benchmarks.first_order simulator=runs/sample/models/ensemble_of_history_mlps.pt
    python -m benchmarks.first_order simulator=MODEL.pt "algorithms=[shac]" steps.shac=300000
    python -m benchmarks.first_order simulator=FITTED.yaml simulators.shac=SURROGATE.yaml

Each training is validated on ten paths that it never sees, clocks stopped meanwhile, until its
steps are used up; then the policy drives lap, infinity and the tight random path on the reference
car, by its camera. A row a validation in `output`; run again, trainings that are in it are not
repeated.
"""

import csv
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from buggy_rl.core.config import build, from_command_line, run
from buggy_rl.jobs.bar import tqdm
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.evaluation.drives import ROOM, benchmark_paths, evaluation_task
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.run import (
    ALGORITHMS,
    PolicyRunConfig,
    new_engine,
    new_policy,
    started,
    validate,
    validation_environment,
)
from buggy_rl.policies.training.trainer import Trainer
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import make_paths

REPEATS = 4  # drives on each path of the reference car, with other noise of the camera
SPUN = 0.5  # [-] of the waypoints in the policy's own simulator, below which a drive is a spin
COLUMNS = (
    *("algorithm", "seed", "steps", "cpu_seconds", "seconds", "waypoints", "kept_on"),
    *(
        "out_of_range",
        "lateral_rms",
        *(f"{at}_{course}" for at in ("own", "car") for course in ROOM),
    ),
    "spins",
)


@dataclass(frozen=True)
class FirstOrderConfig:
    """What is trained and how often it is looked at."""

    simulator: str = "runs/sample/models/ensemble_of_history_mlps.pt"
    """Where policies are trained; of `shac` one that passes gradients."""
    simulators: dict[str, str] = field(default_factory=dict)
    """Another one of an algorithm, by its name: one with surrogate gradients beside its own."""
    algorithms: list[str] = field(default_factory=lambda: ["shac", "ppo"])
    """Each with the config of its name."""
    seeds: list[int] = field(default_factory=lambda: [0, 1, 2, 3, 4])
    steps: dict[str, int] = field(default_factory=lambda: {"shac": 130_000, "ppo": 400_000})
    """Steps of a training, over which its learning rate falls."""
    every: float = 2.0
    """Seconds of CPU between two validations."""
    output: str = "runs/first_order.csv"
    """Rows, appended."""


def main() -> None:
    """Trains what is left, and prints the last row of each training."""
    config = from_command_line(__doc__, "benchmarks.first_order:FirstOrderConfig")
    torch.set_num_threads(1)
    file = Path(config.output)
    known = {(row["algorithm"], int(row["seed"])) for row in read(file)}
    asked = [(name, seed) for name in config.algorithms for seed in config.seeds]
    for name, seed in tqdm([one for one in asked if one not in known], "training", unit="policy"):
        append(file, list(trained(config, name, seed)), COLUMNS)
    for row in last_rows(read(file)):
        print("  ".join(f"{column} {row[column]}" for column in COLUMNS if row[column]))


def new_training(
    name: str, seed: int, simulator: str, more: Sequence[str] = ()
) -> tuple[PolicyRunConfig, Policy, Trainer]:
    """A training by the config of an algorithm's name, and `more` over it."""
    layers = [f"configs/{name}.yaml", *more, "output=unused", f"engine.simulator={simulator}"]
    asked = build(PolicyRunConfig, [*layers, f"algorithm={name}", f"{name}.seed={seed}"])
    torch.manual_seed(seed)
    env = make_env(new_engine(asked.engine, asked.settings.cars), task=asked.task)
    policy = started(env, asked.start) or new_policy(env, asked.policy)
    return asked, policy, ALGORITHMS[name](env, policy, asked.settings, None)


def trained(config: FirstOrderConfig, name: str, seed: int) -> Iterator[dict[str, Any]]:
    """Rows of one training."""
    simulator = config.simulators.get(name, config.simulator)
    asked, policy, trainer = new_training(
        name, seed, simulator, [f"{name}.steps={config.steps[name]}"]
    )
    validation = validation_environment(asked)
    spent, looked = [0.0, 0.0], config.every
    clock = _clocks()
    for _ in trainer.run():
        spent = [one + now - then for one, now, then in zip(spent, _clocks(), clock, strict=True)]
        ended = trainer.steps >= asked.settings.steps
        if spent[0] >= looked or ended:
            looked += config.every
            row = {"algorithm": name, "seed": seed, "steps": trainer.steps}
            row |= {"cpu_seconds": round(spent[0], 2), "seconds": round(spent[1], 2)}
            scores = validate(validation, policy, asked.validation_steps)
            shown = ("waypoints", "kept_on", "out_of_range", "lateral_rms")
            row |= {column: round(scores[f"validation_{column}"], 4) for column in shown}
            yield row | (transferred(simulator, policy, asked.task) if ended else {})
        clock = _clocks()


def _clocks() -> tuple[float, float]:
    return time.process_time(), time.perf_counter()


def transferred(simulator: str, policy: Policy, task: TaskConfig) -> dict[str, Any]:
    """Mean waypoints on the paths of a room, in the policy's simulator and on the reference car."""
    found: dict[str, Any] = {"spins": 0}
    for course in ROOM:
        own = driven(simulator, policy, task, course, camera=False)
        car = driven("reference", policy, task, course, camera=True)
        found[f"own_{course}"] = round(own.mean().item(), 1)
        found[f"car_{course}"] = round(car.mean().item(), 1)
        found["spins"] += int((car < SPUN * own.mean()).sum())
    return found


def driven(
    simulator: str, policy: Policy, task: TaskConfig, course: str, camera: bool
) -> torch.Tensor:
    """Waypoints [N] of drives on one path."""
    benchmark = benchmark_paths(task.paths, 1)[course]
    own = evaluation_task(task, benchmark.steps, camera)
    engine = build(PolicyRunConfig, ["output=unused", f"engine.simulator={simulator}"]).engine
    env = make_env(new_engine(engine, REPEATS), task=own, paths=make_paths(benchmark.paths))
    with torch.random.fork_rng(), torch.no_grad():
        torch.manual_seed(0)
        return drive(env, policy.driver(), benchmark.steps).waypoints.flatten()


def read(file: Path) -> list[dict[str, str]]:
    """Rows so far."""
    if not file.exists():
        return []
    with file.open() as lines:
        return list(csv.DictReader(lines))


def append(file: Path, rows: list[dict[str, Any]], columns: Sequence[str]) -> None:
    """Adds the rows of one training."""
    file.parent.mkdir(parents=True, exist_ok=True)
    begun = not file.exists()
    with file.open("a", newline="") as lines:
        table = csv.DictWriter(lines, columns)
        if begun:
            table.writeheader()
        table.writerows(rows)


def last_rows(rows: list[dict[str, str]]) -> list[dict[str, str]]:
    """The last row of each training."""
    return list({(row["algorithm"], row["seed"]): row for row in rows}.values())


if __name__ == "__main__":
    run(main)
