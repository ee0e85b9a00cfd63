"""Drives of trained policies: on the concealed car, and in the simulator of their training."""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.drives import joined
from buggy_rl.files import write_json
from buggy_rl.jobs import digest
from buggy_rl.plants import make_plant
from buggy_rl.policies.actor_critic import load_policy
from buggy_rl.policies.benchmark_paths import benchmark_paths, evaluation_task
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.run import task_of
from buggy_rl.policies.track_reset import TrackReset
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.transfer.plan import SHARED, TransferConfig
from buggy_rl.vehicle import CONTROL_PERIOD

ENDLESS = ("lap", "infinity")  # can be driven for any time; the tight random path ends
ROOM = (*ENDLESS, "random")
CAR = "car"  # the place that is not a simulator


@dataclass(frozen=True)
class Judged:
    """Policies that drive side by side in one place, and the file that holds how."""

    file: Path
    place: str
    """`car`, or the simulator."""
    case: Case | None
    """The car; None in a simulator."""
    policies: tuple[tuple[str, int, str], ...]
    """Arm, seed and file of each."""
    seconds: float
    """Of a drive on the endless paths [s]."""
    drives: int
    """Of each policy on each path."""

    @property
    def settings(self) -> dict[str, Any]:
        """What the drives depend on, as JSON holds it."""
        case = None if self.case is None else asdict(self.case)
        listed = [[*policy, digest(policy[2])] for policy in self.policies]
        rest = {"seconds": self.seconds, "drives": self.drives, "marshal": True}
        return {"place": self.place, "case": case, "policies": listed, **rest}

    @property
    def done(self) -> bool:
        """Whether the file is there, of the same settings."""
        return self.file.exists() and json.loads(self.file.read_text())["asked"] == self.settings

    def cars(self, count: int) -> EnvBase:
        """So many, of this place."""
        if self.case is None:
            return make_simulator(self.place, count)
        return make_plant(self.case.plant, count, self.case.faults)


def judgements(config: TransferConfig) -> list[Judged]:
    """Every drive of the study: each arm in its simulator, all of them on each car."""
    how = (config.judged_seconds, config.judged_drives)

    def trained(*wanted: tuple[str, str]) -> tuple[tuple[str, int, str], ...]:
        found = (p for pair in wanted for p in config.policies() if (p.arm, p.car) == pair)
        return tuple((p.arm, p.seed, str(config.folder(p) / "best.pt")) for p in found)

    listed = []
    for arm, car in config.places():
        place, policies = config.simulator_of(arm, car), trained((arm, car))
        listed.append(Judged(config.own_drives(arm, car), place, None, policies, *how))
    for car, case in config.cases.items():
        policies = trained(*((arm, "" if arm in SHARED else car) for arm in config.arms))
        listed.append(Judged(config.car_drives(car), CAR, case, policies, *how))
    return listed


def unjudged(config: TransferConfig) -> list[Judged]:
    """What is still to be driven.

    Raises:
        ValueError: A policy is not trained yet.
    """
    left = [judged for judged in judgements(config) if not judged.done]
    files = dict.fromkeys(file for judged in left for _, _, file in judged.policies)
    missing = [file for file in files if not Path(file).exists()]
    if missing:
        raise ValueError(f"{len(missing)} policies are not trained yet, such as {missing[0]}")
    return left


def judge(judged: Judged) -> int:
    """Lets policies drive and writes their file; how many they are."""
    rows = list(driven(judged))
    write_json(judged.file, {"asked": judged.settings, "drives": rows})
    return len(judged.policies)


def driven(judged: Judged) -> Iterator[dict[str, Any]]:
    """One row for each policy and path: means over its drives.

    Yields:
        `arm`, `seed`, `course`, `minutes`, the fields of `closed_loop.Scores`, and `put_back`, the
        number of resets to the path.
    """
    loaded = [load_policy(file) for _, _, file in judged.policies]
    task = task_of(loaded[0][1], judged.policies[0][2])
    drivers = [policy.driver() for policy, _ in loaded]
    driver = joined(drivers, [judged.drives] * len(drivers))
    for course in ROOM:
        known = benchmark_paths(task.paths, 1)[course]
        endless = course in ENDLESS
        steps = round(judged.seconds / CONTROL_PERIOD) if endless else known.steps
        # The car is seen through its camera; a simulator as in training.
        seen = replace(evaluation_task(task, steps, judged.case is not None), paths=known.paths)
        with torch.random.fork_rng():
            torch.manual_seed(0)
            cars = judged.cars(len(loaded) * judged.drives)
            env = make_env(cars, task=seen)
            reset = TrackReset(env)
            scores = drive(env, driver, steps, reset)
        minutes = steps * CONTROL_PERIOD / 60.0
        for place, (arm, seed, _) in enumerate(judged.policies):
            rows = slice(place * judged.drives, (place + 1) * judged.drives)
            means = {name: mean_of(value[rows]) for name, value in vars(scores).items()}
            means["put_back"] = mean_of(reset.times[rows])
            yield {"arm": arm, "seed": seed, "course": course, "minutes": minutes, **means}


def mean_of(values: Tensor) -> float | None:
    """None where there is none, which JSON can hold."""
    mean = values.mean().item()
    return None if math.isnan(mean) else mean
