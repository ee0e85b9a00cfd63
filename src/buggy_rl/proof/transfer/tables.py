"""The two tables that the page is made of, and their files: all drives, and all cars."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from buggy_rl.core.files import write_atomically
from buggy_rl.jobs import read_outcome
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.transfer.plan import Trained, TransferConfig

KEY = ["car", "arm", "seed", "course"]
UNITS = {
    "own": "waypoints closed in the policy's own simulator [1/min]",
    "there": "waypoints closed on the car [1/min]",
    "own_lateral": "mean distance from the path in the own simulator [m]",
    "lateral": "mean distance from the path on the car [m]",
    "own_put_back": "resets to the path in the own simulator [1/min]",
    "put_back": "resets to the path on the car [1/min]",
    "steps": "steps of the training",
    "seconds": "wall time of the training's process [s]",
}
DECIMALS = 4  # of what is written


def write_tables(config: TransferConfig, cases: Mapping[str, Case]) -> None:
    """Writes `drives.csv` and `cars.csv`; rows of cars not trained for stay as they are."""
    folder = Path(config.output)
    tables = {"drives": drives_table(config), "cars": cars_table(config, cases)}
    if config.only and (folder / "drives.csv").exists():
        for name, before in zip(tables, read_tables(folder), strict=True):
            others = before[~before.car.isin(config.trained_cars)]
            both = pd.concat([others, tables[name]]).sort_values("car", kind="stable")
            tables[name] = both.round(DECIMALS)
    for name, table in reversed(tables.items()):  # with drives.csv there is cars.csv
        text = table.to_csv(index=False, lineterminator="\n")
        write_atomically(folder / f"{name}.csv", text)


def all_driven(config: TransferConfig) -> bool:
    """Whether every car of the study has rows in `drives.csv`."""
    return {*read_tables(Path(config.output))[0].car} >= {*config.names}


def read_tables(folder: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Drives and cars.

    Raises:
        ValueError: They were not written yet.
    """
    files = [folder / f"{name}.csv" for name in ("drives", "cars")]
    for file in files:
        if not file.exists():
            raise ValueError(f"there is no {file}: run the stages before page")
    drives = pd.read_csv(files[0], dtype={"car": "str"})
    return drives, pd.read_csv(files[1], dtype="str", keep_default_na=False)


def drives_table(config: TransferConfig) -> pd.DataFrame:
    """A row for each car trained for, arm, seed and path, driven on the car and in simulation.

    Its columns are those of `KEY` and `UNITS`.

    Raises:
        ValueError: There is none.
    """
    own, there = [], []
    for car in config.trained_cars:
        there += [{"car": car, **row} for row in _drives(config.driven(car))]
        for arm in config.arms:
            own += [{"car": car, **row} for row in _drives(config.driven(car, arm))]
    columns = [*KEY, "minutes", "waypoints", "lateral_mean", "put_back"]
    on_car, simulated = (pd.DataFrame(rows, columns=columns) for rows in (there, own))
    both = on_car.merge(simulated, on=KEY, suffixes=("", "_own"))
    if both.empty:
        raise ValueError(f"{config.output} has no drives yet: run the stages before page")
    trained = [Trained(*row) for row in zip(both.arm, both.car, both.seed, strict=True)]
    table = both[KEY].assign(
        own=both.waypoints_own / both.minutes_own,
        there=both.waypoints / both.minutes,
        own_lateral=both.lateral_mean_own,
        lateral=both.lateral_mean,
        own_put_back=both.put_back_own / both.minutes_own,
        put_back=both.put_back / both.minutes,
        steps=[config.steps_of(policy.arm) for policy in trained],
        seconds=[read_outcome(config.folder(policy))["seconds"] for policy in trained],
    )
    return table.round(DECIMALS)


def _drives(file: Path) -> list[dict[str, Any]]:
    return json.loads(file.read_text())["drives"] if file.exists() else []


def cars_table(config: TransferConfig, cases: Mapping[str, Case]) -> pd.DataFrame:
    """A row for each car trained for: `car`, `concealed`, `verdict`, `named`; empty for nothing."""
    rows = []
    for car in config.trained_cars:
        hidden = [_effect(name, numbers) for name, numbers in cases[car].concealed.items()]
        file, said = config.answer(car), ["not diagnosed", ""]
        if file.exists():
            answer = json.loads(file.read_text())
            named = [_said(effect) for effect in answer["effects"]]
            said = [answer["verdict"].replace("_", " "), "; ".join(named)]
        rows.append([car, "; ".join(hidden), *said])
    return pd.DataFrame(rows, columns=["car", "concealed", "verdict", "named"])


def _said(effect: Mapping[str, Any]) -> str:
    numbers = {name: value["value"] for name, value in effect["parameters"].items()}
    return f"{_effect(effect['name'], numbers)} ({100 * effect['confidence']:.0f} %)"


def _effect(name: str, numbers: Mapping[str, float]) -> str:
    return f"{name} {', '.join(f'{key} {value:.3g}' for key, value in numbers.items())}"
