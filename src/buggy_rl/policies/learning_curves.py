"""Learning curves: what the logs of several runs of one kind say together."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

SHOWN = {"waypoints": "training", "validation_waypoints": "validation"}  # metric -> paths


@dataclass(frozen=True)
class ShowLearningConfig:
    """Runs whose learning is drawn."""

    output: str = "runs/learning.png"
    """The picture: .png, .svg or .pdf."""
    runs: dict[str, list[str]] = field(default_factory=dict)
    """Folders of scripts/train_policy.py, one a seed, as runs.NAME=[FOLDER,FOLDER]."""
    drivers: dict[str, str] = field(default_factory=dict)
    """Tables drivers.csv of scripts/tune_drivers.py for the same names: pure pursuit's score."""


@dataclass(frozen=True)
class Curve:
    """One metric of all runs of one kind."""

    name: str
    metric: str
    band: pd.DataFrame
    """By steps: mean, low and high over the runs."""
    runs: int
    """How many they are."""
    score: float | None
    """What the tuned pure pursuit closes on the same paths."""


def curves(config: ShowLearningConfig) -> list[Curve]:
    """Reads the logs of all runs.

    Raises:
        ValueError: There is no run, no such log, or no such score.
    """
    if not config.runs:
        raise ValueError("no run to show: name some, as runs.NAME=[FOLDER,FOLDER]")
    strangers = sorted(set(config.drivers) - set(config.runs))
    if strangers:
        raise ValueError(f"drivers={strangers}: the runs are {', '.join(config.runs)}")
    found = []
    for name, folders in config.runs.items():
        for metric, course in SHOWN.items():
            runs = [read_log(Path(folder), metric) for folder in folders]
            table = config.drivers.get(name)
            score = read_score(Path(table), course) if table else None
            found.append(Curve(name, metric, band(runs), len(runs), score))
    return found


def read_log(folder: Path, metric: str) -> pd.Series:
    """One metric of a run by its steps.

    Raises:
        ValueError: The run has no such log.
    """
    file = folder / "csv" / "scalars" / f"{metric}.csv"
    if not file.is_file():
        raise ValueError(
            f"there is no log {file}: is {folder} a run of scripts/train_policy.py, or a model's "
            "folder of scripts/train_models.py?"
        )
    table = pd.read_csv(file, header=None, names=["steps", "value"]).dropna()
    table = table.drop_duplicates("steps", keep="last")  # a stop between row and checkpoint
    return pd.Series(table["value"].to_numpy(), pd.Index(table["steps"], name="steps"))


def read_score(file: Path, course: str, driver: str = "pure_pursuit") -> float:
    """Waypoints that a driver closes on a set of paths.

    Raises:
        ValueError: The table is not there or has no such row.
    """
    if not file.is_file():
        raise ValueError(f"there is no table {file}: make it with scripts/tune_drivers.py")
    table = pd.read_csv(file)
    found = table.query("driver == @driver and course == @course")["waypoints"].tolist()
    if len(found) != 1:
        raise ValueError(f"{file} has {len(found)} rows of {driver} on {course}: one is expected")
    return float(found[0])


def band(runs: Sequence[pd.Series]) -> pd.DataFrame:
    """Mean, lowest and highest of runs at the steps that all of them have reached."""
    table = pd.concat(runs, axis=1, join="inner").sort_index()
    return pd.DataFrame(
        {"mean": table.mean(axis=1), "low": table.min(axis=1), "high": table.max(axis=1)}
    )
