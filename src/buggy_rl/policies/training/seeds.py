"""One policy for each of several seeds, trained as independent jobs.

OUTPUT/seeds.yaml     the config that all share
OUTPUT/seed_N/        what scripts/train_policy.py writes, with the job's log.txt
OUTPUT/seeds.csv      the best validation of each
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from buggy_rl.core.config import plain_values
from buggy_rl.jobs import Job
from buggy_rl.jobs.launching import Launching
from buggy_rl.policies.training.actor_critic import load_policy
from buggy_rl.policies.training.run import PolicyRunConfig, policy_question

CHECKPOINT = "checkpoint.pt"
LOGGED = Path("csv") / "scalars" / "reward.csv"  # steps, value: grows as a policy is trained


@dataclass(frozen=True)
class PolicyTrainingConfig(PolicyRunConfig, Launching):
    """A policy, or one for each seed."""

    seeds: list[int] = field(default_factory=list)
    """Trains one policy for each in OUTPUT/seed_N, `seed` and that of the algorithm replaced; empty
    for one policy in OUTPUT."""
    workers: int = 2
    """Seeds at a time."""

    def __post_init__(self) -> None:
        if len(set(self.seeds)) < len(self.seeds):
            raise ValueError(f"seeds={self.seeds}: one of them stands there twice")

    @property
    def single(self) -> PolicyRunConfig:
        """The part that is one training."""
        return PolicyRunConfig(**{f.name: getattr(self, f.name) for f in fields(PolicyRunConfig)})


def seed_jobs(config: PolicyTrainingConfig, script: Path) -> list[Job]:
    """One job for each seed.

    Args:
        config: With seeds.
        script: `train_policy.py`.
    """
    file = Path(config.output) / "seeds.yaml"
    return [_training(file, seed, config, script) for seed in config.seeds]


def _training(file: Path, seed: int, config: PolicyTrainingConfig, script: Path) -> Job:
    """The job of one seed; `file` is the config that all share, written when one begins."""
    folder, shared = file.parent / f"seed_{seed}", replace(config.single, resume=False)
    settings: Any = shared.settings
    changed: dict[str, Any] = {shared.algorithm: replace(settings, seed=seed)}
    own = replace(shared, seed=seed, **changed)
    options = (f"seed={seed}", f"{shared.algorithm}.seed={seed}", f"output={folder}")
    return Job(
        f"seed {seed}",
        folder,
        (str(script), str(file), *options),
        question=policy_question(own),
        texts={file: yaml.safe_dump(plain_values(shared), sort_keys=False)},
        work=config.settings.steps,
        checkpoint=CHECKPOINT,
        share=partial(share_trained, folder, config.settings.steps),
    )


def share_trained(folder: Path, steps: int) -> float:
    """How much of its training a policy has behind it, by its log."""
    file = folder / LOGGED
    if not file.exists() or not (lines := file.read_text().splitlines()):
        return 0.0
    return min(int(float(lines[-1].partition(",")[0])) / steps, 1.0)


def validations(folders: Sequence[Path]) -> list[dict[str, Any]]:
    """The validation of the best policy in each folder: one row of `validation_...` a folder."""
    rows = []
    for folder in folders:
        _, about = load_policy(folder / "best.pt")
        values = {k: v for k, v in about.items() if k.startswith("validation_")}
        rows.append({"seed": about["config"]["seed"], "steps": about["steps"], **values})
    return rows


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
    """Band by steps: mean, low and high over the runs."""
    runs: int
    """Number of the runs."""
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
