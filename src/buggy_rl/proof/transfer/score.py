"""Waypoints that policies close on the car, against those that they close in simulation.

The drives are a table with a row for each policy and path: `car`, `arm`, `seed`, `course`,
`control` (whether nothing is wrong with the car) and the columns of `UNITS`.
"""

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Any

import pandas as pd
import torch
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core.files import write_json
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.jobs import digest
from buggy_rl.policies.closed_loop import TrackReset, drive
from buggy_rl.policies.evaluation.drives import benchmark_paths, evaluation_task
from buggy_rl.policies.evaluation.tables import ORIGINAL, mean_interval
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.run import task_of
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.drives import joined
from buggy_rl.proof.plants import make_plant
from buggy_rl.proof.transfer.plan import SHARED, TransferConfig
from buggy_rl.task.env import make_env, make_simulator

CURED = 0.2  # share of the unrepaired policy's loss that the repaired one may have
KEY = ["car", "arm", "seed", "course"]
UNITS = {
    "own": "waypoints closed in the policy's own simulator [1/min]",
    "there": "waypoints closed on the car [1/min]",
    "lost": "their difference [1/min]",
    "own_lateral": "mean distance from the path in the own simulator [m]",
    "lateral": "mean distance from the path on the car [m]",
    "own_put_back": "resets to the path in the own simulator [1/min]",
    "put_back": "resets to the path on the car [1/min]",
}
COUNTED = list(UNITS)


@dataclass(frozen=True)
class Target:
    """What the study has to show."""

    sentence: str
    met: bool


def pairs(config: TransferConfig) -> pd.DataFrame:
    """Every policy and path that was driven both on a car and in simulation.

    Raises:
        ValueError: There is none.
    """
    own, there = [], []
    for car in config.cars:
        there += [{"car": car, **row} for row in _drives(config.car_drives(car))]
        for arm in config.arms:
            file = config.own_drives(arm, "" if arm in SHARED else car)
            own += [{"car": car, **row} for row in _drives(file)]
    columns = [*KEY, "minutes", "waypoints", "lateral_mean", "put_back"]
    on_car, simulated = (pd.DataFrame(rows, columns=columns) for rows in (there, own))
    both = on_car.merge(simulated, on=KEY, suffixes=("", "_own"))
    if both.empty:
        raise ValueError(f"{config.output} has no drives yet: run the stages before page")
    drives = both[KEY].assign(
        own=both.waypoints_own / both.minutes_own, there=both.waypoints / both.minutes
    )
    return drives.assign(
        lost=drives.own - drives.there,
        own_lateral=both.lateral_mean_own,
        lateral=both.lateral_mean,
        own_put_back=both.put_back_own / both.minutes_own,
        put_back=both.put_back / both.minutes,
        control=[not config.cars[car] for car in both.car],
    )


def _drives(file: Path) -> list[dict[str, Any]]:
    return json.loads(file.read_text())["drives"] if file.exists() else []


def counted(drives: pd.DataFrame) -> pd.DataFrame:
    """Drives without the cars that have nothing wrong, unless there are no others."""
    return drives if drives.control.all() else drives.loc[~drives.control]


def means(drives: pd.DataFrame, *by: str) -> pd.DataFrame:
    """Means of all columns by car, arm, seed or course, in the order of their first appearance."""
    return pd.DataFrame(drives.groupby(list(by), sort=False)[COUNTED].mean())


def over_seeds(drives: pd.DataFrame, arm: str, column: str) -> tuple[float, float]:
    """95 % interval of an arm's mean over seeds."""
    return mean_interval(means(drives.loc[drives.arm == arm], "seed")[column].tolist())


def targets(drives: pd.DataFrame) -> list[Target]:
    """What the study has to show, and whether it does; none without both arms it is about."""
    arms = means(counted(drives), "arm")
    if not {"unrepaired", "repaired"} <= set(arms.index):
        return []
    lost, there = arms.lost, arms.there
    best = there.drop("repaired").idxmax()
    return [
        Target(
            f"The repaired simulator's policy loses {lost['repaired']:.1f} waypoints a minute, "
            f"at most a fifth of the {lost['unrepaired']:.1f} that the unrepaired one's loses.",
            bool(lost["repaired"] <= CURED * max(lost["unrepaired"], 0.0)),
        ),
        Target(
            f"It closes {there['repaired']:.1f} a minute on the car, at least as many as any "
            f"other ({best}: {there[best]:.1f}).",
            bool(there["repaired"] >= there[best]),
        ),
    ]


def original_loss() -> dict[str, tuple[float, float]]:
    """Loss of the original study's policies: waypoints closed in simulation and lost from there."""
    lost, own = ORIGINAL["lost"]["mean"], ORIGINAL["own simulator"].values()
    return {kind: (fmean(float(row[kind]) for row in own), float(lost[kind])) for kind in lost}


def answers(config: TransferConfig) -> dict[str, dict[str, Any]]:
    """`diagnosis.json` of each car."""
    files = {car: config.car(car) / "diagnosis" / "diagnosis.json" for car in config.cars}
    return {car: json.loads(file.read_text()) for car, file in files.items() if file.exists()}


def transfer_results(config: TransferConfig, drives: pd.DataFrame) -> dict[str, Any]:
    """All drives, their means and the targets, as JSON holds them."""

    def listed(of: pd.DataFrame, *by: str) -> list[dict[Any, Any]]:
        return means(of, *by).reset_index().to_dict("records")

    return {
        "unit": "waypoints a minute",
        "seeds": config.seeds,
        "steps": config.steps,
        "targets": [asdict(target) for target in targets(drives)],
        "arms": listed(counted(drives), "arm"),
        "cars": listed(drives, "car", "arm"),
        "courses": listed(counted(drives), "course", "arm"),
        "drives": drives.to_dict("records"),
    }


ENDLESS = ("lap", "infinity")  # can be driven for any time; the tight random path ends
ROOM = (*ENDLESS, "random")
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
        rest = {"seconds": self.seconds, "drives": self.drives, "marshal": True}
        return {"place": self.place, "case": case, "policies": listed, **rest}

    @property
    def done(self) -> bool:
        """Whether the file is there, of the same settings."""
        return self.file.exists() and json.loads(self.file.read_text())["asked"] == self.settings

    def cars(self, count: int) -> EnvBase:
        """Makes `count` cars of this place, one an environment."""
        if self.case is None:
            return make_simulator(self.place, count)
        return make_plant(self.case.plant, count, self.case.faults)


def judgements(config: TransferConfig) -> list[PolicyBatch]:
    """Every drive of the study: each arm in its simulator, all of them on each car."""
    how = (config.judged_seconds, config.judged_drives)

    def trained(*wanted: tuple[str, str]) -> tuple[tuple[str, int, str], ...]:
        found = (p for pair in wanted for p in config.policies() if (p.arm, p.car) == pair)
        return tuple((p.arm, p.seed, str(config.folder(p) / "best.pt")) for p in found)

    listed = []
    for arm, car in config.places():
        place, policies = config.simulator_of(arm, car), trained((arm, car))
        listed.append(PolicyBatch(config.own_drives(arm, car), place, None, policies, *how))
    for car, case in config.cases.items():
        policies = trained(*((arm, "" if arm in SHARED else car) for arm in config.arms))
        listed.append(PolicyBatch(config.car_drives(car), CAR, case, policies, *how))
    return listed


def unjudged(config: TransferConfig) -> list[PolicyBatch]:
    """Batches that are still to be driven.

    Raises:
        ValueError: A policy is not trained yet.
    """
    left = [judged for judged in judgements(config) if not judged.done]
    files = dict.fromkeys(file for judged in left for _, _, file in judged.policies)
    missing = [file for file in files if not Path(file).exists()]
    if missing:
        raise ValueError(f"{len(missing)} policies are not trained yet, such as {missing[0]}")
    return left


def drive_policies(judged: PolicyBatch) -> int:
    """Lets policies drive and writes their file; how many they are."""
    rows = list(drive_rows(judged))
    write_json(judged.file, {"asked": judged.settings, "drives": rows})
    return len(judged.policies)


def drive_rows(judged: PolicyBatch) -> Iterator[dict[str, Any]]:
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
