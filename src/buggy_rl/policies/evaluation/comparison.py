"""Finished or running policy runs side by side, from their folders alone."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean, stdev

import pandas as pd
import yaml

from buggy_rl.policies.training.seeds import band, read_log

COSTS = "loss", "error", "lateral", "heading", "out_of_range"  # in the names of what is to be low


@dataclass(frozen=True)
class CompareConfig:
    """Runs that are compared."""

    output: str = "runs/comparison"
    """The folder of the table and the picture."""
    runs: dict[str, list[str]] = field(default_factory=dict)
    """Folders of scripts/train_policy.py, one a seed, as runs.NAME=[FOLDER,FOLDER]; or of models,
    OUTPUT/models/NAME of scripts/train_models.py."""
    sweep: str = ""
    """A folder of runs, instead of `runs`: grouped by their config without seed and output."""
    metrics: list[str] = field(default_factory=lambda: ["validation_waypoints", "waypoints"])
    """Logs that are compared: names of files in FOLDER/csv/scalars."""


@dataclass(frozen=True)
class Comparison:
    """What the runs of all groups say together."""

    bands: dict[tuple[str, str], pd.DataFrame]
    """Bands by group and metric: mean, low and high over the steps that all its runs have."""
    table: pd.DataFrame
    """A row for each group and metric: final and best value, mean and sd over its runs."""
    differences: pd.DataFrame
    """Config values that differ: a row for each option, a column for each group."""


def compare_runs(config: CompareConfig) -> Comparison:
    """Reads the logs and configs of all runs.

    Raises:
        ValueError: No run is named, a folder is no run, it lacks a log, or seeds share no step.
    """
    if bool(config.runs) == bool(config.sweep):
        raise ValueError("name some runs.NAME=[FOLDER,FOLDER], or sweep=FOLDER, and not both")
    runs = config.runs or grouped(Path(config.sweep))
    empty = [name for name, folders in runs.items() if not folders]
    if empty or not config.metrics:
        raise ValueError(f"runs without folders: {empty}; metrics={config.metrics}: name one each")
    bands, rows = {}, []
    for name, folders in runs.items():
        for metric in config.metrics:
            logs = [read_log(Path(folder), metric) for folder in folders]
            bands[name, metric] = band(logs)
            if bands[name, metric].empty:
                raise ValueError(f"the runs of {name} have no step of {metric} in common")
            rows.append({"group": name, "metric": metric, **summary(logs, is_cost(metric))})
    return Comparison(bands, pd.DataFrame(rows), _differences(runs))


def grouped(sweep: Path) -> dict[str, list[str]]:
    """The runs in a folder by the config values that differ among them, as `a.b=value`.

    Raises:
        ValueError: The folder holds no run.
    """
    configs = {str(f.parent): read_config(f.parent) for f in sorted(sweep.glob("*/config.yaml"))}
    if not configs:
        raise ValueError(f"sweep={sweep}: no folder in it holds a config.yaml, so none is a run")
    varied = _differences({folder: [folder] for folder in configs}).index
    groups: dict[str, list[str]] = {}
    for folder, config in configs.items():
        name = ", ".join(f"{key}={config.get(key, '-')}" for key in varied) or sweep.name
        groups.setdefault(name, []).append(folder)
    return groups


def summary(logs: list[pd.Series], lower_is_better: bool) -> dict[str, float]:
    """Final and best value of each run: mean and sample sd; the sd of one run is NaN."""
    final = [float(log.iloc[-1]) for log in logs]
    best = [float(log.min() if lower_is_better else log.max()) for log in logs]
    steps = [int(log.index[-1]) for log in logs]
    return {
        "runs": len(logs),
        "final_mean": mean(final),
        "final_sd": _sample_sd(final),
        "best_mean": mean(best),
        "best_sd": _sample_sd(best),
        "least_steps": min(steps),
        "most_steps": max(steps),
    }


def is_cost(metric: str) -> bool:
    """Whether the lowest value is the best: losses, errors and distances from the path."""
    return any(part in metric for part in COSTS)


def _differences(runs: Mapping[str, list[str]]) -> pd.DataFrame:
    """Config values that differ between groups; `seed` and `output` aside."""
    groups = {name: [read_config(Path(f)) for f in folders] for name, folders in runs.items()}
    keys = dict.fromkeys(key for configs in groups.values() for c in configs for key in c)
    rows = {}
    for key in keys:
        values = {n: _values(key, configs) for n, configs in groups.items()}
        if len(set(values.values())) > 1:
            rows[key] = values
    return pd.DataFrame.from_dict(rows, orient="index", columns=list(runs))


def read_config(folder: Path) -> dict[str, str]:
    """The resolved config of a run as `a.b` -> value, without `seed` and `output`.

    Raises:
        ValueError: The folder is no run.
    """
    file = folder / "config.yaml"
    if not file.is_file():
        raise ValueError(f"there is no {file}: is {folder} the folder of a run?")
    flat = dict(_flat(yaml.safe_load(file.read_text())))
    return {k: v for k, v in flat.items() if k.rsplit(".")[-1] not in ("seed", "output")}


def _sample_sd(values: list[float]) -> float:
    return stdev(values) if len(values) > 1 else math.nan


def _values(key: str, configs: list[dict[str, str]]) -> str:
    return " | ".join(sorted({config.get(key, "-") for config in configs}))


def _flat(content: Mapping, prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in content.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", str(value)
