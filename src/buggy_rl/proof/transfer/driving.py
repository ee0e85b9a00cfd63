"""Drives of policies, on the cars and in the simulators that they were trained in."""

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core.files import write_json
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.jobs import digest
from buggy_rl.policies.closed_loop import TrackReset, drive
from buggy_rl.policies.evaluation.drives import ROOM, benchmark_paths, evaluation_task
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.run import task_of
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import joined, plant_of, plant_parameters
from buggy_rl.proof.transfer.plan import Trained, TransferConfig
from buggy_rl.task.env import make_env, make_simulator

ENDLESS = ("lap", "infinity")  # can be driven for any time; the tight random path ends
CAR = "car"  # the place that is not a simulator


@dataclass(frozen=True)
class PolicyBatch:
    """Policies that drive side by side in one place, and the file that holds how."""

    file: Path
    place: str
    """`car`, or the simulator."""
    case: Case | None
    """The car; None in a simulator."""
    policies: tuple[tuple[str, int, str], ...]
    """Arm, seed and file of each."""
    seconds: float
    """Length of a drive on the endless paths [s]."""
    drives: int
    """Drives of each policy on each path."""

    @property
    def settings(self) -> dict[str, Any]:
        """What the drives depend on, as JSON holds it."""
        case = None if self.case is None else asdict(self.case)
        listed = [[*policy, digest(policy[2])] for policy in self.policies]
        place = [self.place, "" if self.case else digest(self.place)]
        how = {"seconds": self.seconds, "drives": self.drives}
        return {"place": place, "case": case, "policies": listed, **how}

    @property
    def done(self) -> bool:
        """Whether the file is there, of the same settings."""
        return self.file.exists() and json.loads(self.file.read_text())["asked"] == self.settings

    def cars(self, count: int) -> EnvBase:
        """Makes `count` cars of this place, one an environment."""
        if self.case is None:
            return make_simulator(self.place, count)
        return plant_of(self.case, count, self.case.faults, plant_parameters(self.case))


def batches(config: TransferConfig, cases: Mapping[str, Case]) -> list[PolicyBatch]:
    """Every drive of the cars that are trained for: each arm in its simulator, all on their car."""
    how = (config.judged_seconds, config.judged_drives)

    def trained(car: str, *arms: str) -> tuple[tuple[str, int, str], ...]:
        policies = (Trained(arm, car, seed) for arm in arms for seed in config.seeds)
        return tuple((p.arm, p.seed, str(config.folder(p) / "best.pt")) for p in policies)

    listed = []
    for car in config.trained_cars:
        for arm in config.arms:
            place = config.simulator_of(arm, car)
            file, policies = config.driven(car, arm), trained(car, arm)
            listed.append(PolicyBatch(file, place, None, policies, *how))
        policies = trained(car, *config.arms)
        listed.append(PolicyBatch(config.driven(car), CAR, cases[car], policies, *how))
    return listed


def undriven(config: TransferConfig, cases: Mapping[str, Case]) -> list[PolicyBatch]:
    """Batches that are still to be driven.

    Raises:
        ValueError: A policy is not trained yet.
    """
    left = [batch for batch in batches(config, cases) if not batch.done]
    files = dict.fromkeys(file for batch in left for _, _, file in batch.policies)
    missing = [file for file in files if not Path(file).exists()]
    if missing:
        raise ValueError(
            f"{len(missing)} policies are not trained yet, such as {missing[0]}: run stage train"
        )
    return left


def drive_policies(batch: PolicyBatch) -> int:
    """Lets policies drive and writes their file; how many they are."""
    rows = list(drive_rows(batch))
    write_json(batch.file, {"asked": batch.settings, "drives": rows})
    return len(batch.policies)


def drive_rows(batch: PolicyBatch) -> Iterator[dict[str, Any]]:
    """One row for each policy and path: means over its drives.

    Yields:
        `arm`, `seed`, `course`, `minutes`, the fields of `closed_loop.Scores`, and `put_back`, the
        number of resets to the path.
    """
    loaded = [load_policy(file) for _, _, file in batch.policies]
    task = task_of(loaded[0][1], batch.policies[0][2])
    drivers = [policy.driver() for policy, _ in loaded]
    driver = joined(drivers, [batch.drives] * len(drivers))
    for course in ROOM:
        known = benchmark_paths(task.paths, 1)[course]
        endless = course in ENDLESS
        steps = round(batch.seconds / CONTROL_PERIOD) if endless else known.steps
        # The car is seen through its camera; a simulator as in training.
        seen = replace(evaluation_task(task, steps, batch.case is not None), paths=known.paths)
        with torch.random.fork_rng():
            torch.manual_seed(0)
            cars = batch.cars(len(loaded) * batch.drives)
            env = make_env(cars, task=seen)
            reset = TrackReset(env)
            scores = drive(env, driver, steps, reset)
        minutes = steps * CONTROL_PERIOD / 60.0
        for place, (arm, seed, _) in enumerate(batch.policies):
            rows = slice(place * batch.drives, (place + 1) * batch.drives)
            means = {name: mean_of(value[rows]) for name, value in vars(scores).items()}
            means["put_back"] = mean_of(reset.times[rows])
            yield {"arm": arm, "seed": seed, "course": course, "minutes": minutes, **means}


def mean_of(values: Tensor) -> float | None:
    """None where there is none, which JSON can hold."""
    mean = values.mean().item()
    return None if math.isnan(mean) else mean
