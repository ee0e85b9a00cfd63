"""What became of the policies: waypoints closed on the car against in simulation."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from buggy_rl.policies.tables import ORIGINAL, mean_interval
from buggy_rl.transfer.plan import SHARED, TransferConfig

CURED = 0.2  # share of the unrepaired one's loss that the repaired one may have
COUNTED = ("own", "there", "lost", "own_lateral", "lateral", "own_put_back", "put_back")


@dataclass(frozen=True)
class Pair:
    """One policy on one path: in its own simulator, and on the car."""

    car: str
    arm: str
    seed: int
    course: str
    own: float
    """Waypoints closed in its simulator, a minute."""
    there: float
    """Waypoints closed on the car, a minute."""
    lost: float
    """Their difference."""
    own_lateral: float
    """Mean distance from the path in its simulator [m]."""
    lateral: float
    """Mean distance from the path on the car [m]."""
    own_put_back: float
    """Times a minute that it had to be put back in its simulator."""
    put_back: float
    """Times a minute that it had to be put back on the car."""
    control: bool = False
    """Whether the car is one with nothing wrong."""


@dataclass(frozen=True)
class Target:
    """What the study has to show."""

    sentence: str
    met: bool


def pairs(config: TransferConfig) -> list[Pair]:
    """Every policy and path that was driven both on a car and in simulation.

    Raises:
        ValueError: None was.
    """
    found = []
    for car in config.cars:
        own = {}
        for arm in config.arms:
            for row in _drives(config.own_drives(arm, "" if arm in SHARED else car)):
                own[arm, row["seed"], row["course"]] = row
        for row in _drives(config.car_drives(car)):
            key = row["arm"], row["seed"], row["course"]
            if key in own:
                found.append(_pair(car, own[key], row, not config.cars[car]))
    if not found:
        raise ValueError(f"{config.output} has no drives yet: run the stages before page")
    return found


def _drives(file: Path) -> list[dict[str, Any]]:
    return json.loads(file.read_text())["drives"] if file.exists() else []


def _pair(car: str, own: dict[str, Any], there: dict[str, Any], control: bool) -> Pair:
    at_home, away = (row["waypoints"] / row["minutes"] for row in (own, there))
    return Pair(
        car,
        there["arm"],
        there["seed"],
        there["course"],
        own=at_home,
        there=away,
        lost=at_home - away,
        own_lateral=own["lateral_mean"],
        lateral=there["lateral_mean"],
        own_put_back=own["put_back"] / own["minutes"],
        put_back=there["put_back"] / there["minutes"],
        control=control,
    )


def counted(drives: Sequence[Pair]) -> list[Pair]:
    """Without the cars that have nothing wrong, unless there are no others."""
    return [drive for drive in drives if not drive.control] or list(drives)


def values(drives: Sequence[Pair], column: str, **where: object) -> list[float]:
    """A column of `COUNTED`, of those drives that are as is said by name."""
    chosen = [d for d in drives if all(getattr(d, k) == v for k, v in where.items())]
    return [getattr(d, column) for d in chosen]


def mean(drives: Sequence[Pair], column: str, **where: object) -> float:
    """Its mean; cars, paths and seeds count alike."""
    return fmean(values(drives, column, **where))


def kinds(drives: Sequence[Pair], name: str) -> list[Any]:
    """All cars, arms, seeds or courses, in the order of their first appearance."""
    return list(dict.fromkeys(getattr(drive, name) for drive in drives))


def over_seeds(drives: Sequence[Pair], arm: str, column: str) -> tuple[float, float]:
    """95 % interval of an arm's mean, seeds being what it varies over."""
    return mean_interval([mean(drives, column, arm=arm, seed=s) for s in kinds(drives, "seed")])


def targets(drives: Sequence[Pair]) -> list[Target]:
    """What the study has to show, and whether it does; none without both arms it is about."""
    drives = counted(drives)
    arms = kinds(drives, "arm")
    if not {"unrepaired", "repaired"} <= set(arms):
        return []
    lost = {arm: mean(drives, "lost", arm=arm) for arm in arms}
    there = {arm: mean(drives, "there", arm=arm) for arm in arms}
    best = max((arm for arm in arms if arm != "repaired"), key=lambda arm: there[arm])
    return [
        Target(
            f"The repaired simulator's policy loses {lost['repaired']:.1f} waypoints a minute, "
            f"at most a fifth of the {lost['unrepaired']:.1f} that the unrepaired one's loses.",
            lost["repaired"] <= CURED * max(lost["unrepaired"], 0.0),
        ),
        Target(
            f"It closes {there['repaired']:.1f} a minute on the car, at least as many as any "
            f"other ({best}: {there[best]:.1f}).",
            there["repaired"] >= there[best],
        ),
    ]


def original_loss() -> dict[str, tuple[float, float]]:
    """Of the original study's policies: waypoints closed in simulation and lost from there."""
    lost, own = ORIGINAL["lost"]["mean"], ORIGINAL["own simulator"].values()
    return {kind: (fmean(float(row[kind]) for row in own), float(lost[kind])) for kind in lost}


def answers(config: TransferConfig) -> dict[str, dict[str, Any]]:
    """What the diagnosis said of each car."""
    files = {car: config.car(car) / "diagnosis" / "diagnosis.json" for car in config.cars}
    return {car: json.loads(file.read_text()) for car, file in files.items() if file.exists()}


def results(config: TransferConfig, drives: Sequence[Pair]) -> dict[str, Any]:
    """Everything that was counted, as JSON holds it."""

    def means(of: Sequence[Pair], *what: str) -> list[dict[str, Any]]:
        groups = dict.fromkeys(tuple(getattr(d, name) for name in what) for d in of)
        named = [dict(zip(what, group, strict=True)) for group in groups]
        return [g | {column: mean(of, column, **g) for column in COUNTED} for g in named]

    return {
        "unit": "waypoints a minute",
        "seeds": config.seeds,
        "steps": config.steps,
        "targets": [asdict(target) for target in targets(drives)],
        "arms": means(counted(drives), "arm"),
        "cars": means(drives, "car", "arm"),
        "courses": means(counted(drives), "course", "arm"),
        "drives": [asdict(drive) for drive in drives],
    }
