"""Waypoints that policies close on the car, against those that they close in simulation.

The drives are a table with a row for each policy and path: `car`, `arm`, `seed`, `course`,
`control` (whether nothing is wrong with the car) and the columns of `UNITS`.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import pandas as pd

from buggy_rl.policies.tables import ORIGINAL, mean_interval
from buggy_rl.transfer.plan import SHARED, TransferConfig

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
    """Without the cars that have nothing wrong, unless there are no others."""
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
    """Of the original study's policies: waypoints closed in simulation and lost from there."""
    lost, own = ORIGINAL["lost"]["mean"], ORIGINAL["own simulator"].values()
    return {kind: (fmean(float(row[kind]) for row in own), float(lost[kind])) for kind in lost}


def answers(config: TransferConfig) -> dict[str, dict[str, Any]]:
    """`diagnosis.json` of each car."""
    files = {car: config.car(car) / "diagnosis" / "diagnosis.json" for car in config.cars}
    return {car: json.loads(file.read_text()) for car, file in files.items() if file.exists()}


def results(config: TransferConfig, drives: pd.DataFrame) -> dict[str, Any]:
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
