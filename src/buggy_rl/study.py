"""A study: which drives, which models trained how, which simulators beside them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from buggy_rl.comparison import Candidate
from buggy_rl.dataset import split
from buggy_rl.engines import make_engine
from buggy_rl.fitting import FitConfig
from buggy_rl.models.factory import ModelConfig, load_model
from buggy_rl.models.training import TrainingConfig
from buggy_rl.recordings import load_recordings
from buggy_rl.recordings.recording import Recording


@dataclass(frozen=True)
class DataConfig:
    """Which drives, and which of them are held back."""

    recordings: list[str] = MISSING
    """Files and folders of drives."""
    columns: str = ""
    """YAML column map, for tables that do not have the standard columns."""
    held_out: list[str] = field(default_factory=list)
    """Names of the drives that only judge; empty holds out `held_out_share`."""
    validation: list[str] = field(default_factory=list)
    """Names of the drives that decide when training stops; empty takes one of the others."""
    held_out_share: float = 0.2
    """Share of the drives to hold out when none is named."""
    leave_out: list[str] = field(default_factory=list)
    """Names of drives to use for nothing, such as those on another floor."""
    seed: int = 0
    """Which drives fall on which side, when none is named."""


@dataclass(frozen=True)
class RunConfig:
    """One kind of model, trained once for each preparation."""

    model: ModelConfig = field(default_factory=ModelConfig)
    training: TrainingConfig = field(default_factory=TrainingConfig)
    preparations: list[str] = field(default_factory=lambda: ["raw"])
    """Any of raw, filtered, mirrored; each becomes a row of the table."""


@dataclass(frozen=True)
class StudyConfig:
    """Everything from drives to the table of simulators."""

    output: str = MISSING
    """Folder for models, fits, table and pictures."""
    data: DataConfig = field(default_factory=DataConfig)
    runs: dict[str, RunConfig] = field(default_factory=dict)
    """Models to train, by the name they have in the table."""
    fit: FitConfig = field(default_factory=FitConfig)
    fit_simulator: str = "mujoco"
    """The simulator that scripts/fit_mujoco.py fits: any that declares parameters."""
    fit_options: dict[str, Any] = field(default_factory=dict)
    """Further arguments of that simulator's class, such as tyres: contact."""
    simulators: dict[str, str] = field(default_factory=dict)
    """Further simulators for the table, by the name they have in it."""
    windows: int = 300
    """Most held-out windows that the table is made over."""
    threads: int = 1
    """Threads of PyTorch."""
    only: list[str] = field(default_factory=list)
    """Train only these models, by their name in the table."""
    shown: list[str] = field(default_factory=list)
    """Simulators whose rollouts are drawn; empty for the best three."""


@dataclass(frozen=True)
class Drives:
    """Drives by what they are used for."""

    training: list[Recording]
    validation: list[Recording]
    held_out: list[Recording]


def load_drives(config: DataConfig, on_refusal: Callable[[str], None]) -> Drives:
    """Reads a study's drives and splits them; what is refused is told, one line each.

    Raises:
        ValueError: Too few drives are left.
    """
    recordings, refusals = load_recordings(config.recordings, config.columns or None)
    for refusal in refusals:
        on_refusal(str(refusal))
    if not recordings:
        raise ValueError(f"no drive could be read from {', '.join(config.recordings)}")
    return divide(recordings, config)


def divide(recordings: list[Recording], config: DataConfig) -> Drives:
    """Splits by whole drives into training, validation and held out.

    Raises:
        ValueError: A name is not there, or there are too few drives.
    """
    known = {r.name for r in recordings}
    missing = sorted(set(config.leave_out) - known)
    if missing:
        raise ValueError(f"cannot leave out {missing}: the drives are {sorted(known)}")
    kept = [r for r in recordings if r.name not in config.leave_out]
    rest, held_out = split(kept, config.held_out or config.held_out_share, config.seed)
    training, validation = split(rest, config.validation or 1 / len(rest), config.seed)
    return Drives(training, validation, held_out)


def model_runs(config: StudyConfig) -> Iterator[tuple[str, ModelConfig, TrainingConfig]]:
    """Every model of a study: its name, what it is, how it is trained."""
    for name, run in config.runs.items():
        for preparation in run.preparations:
            suffix = "" if len(run.preparations) == 1 else f", {preparation}"
            training = replace(run.training, preparation=preparation)
            yield name + suffix, run.model, training


def fit_file(config: StudyConfig) -> str:
    """Name of the fitted simulator's file in the study's output folder."""
    return f"{file_name(config.fit_simulator)}_fitted.yaml"


def model_file(config: StudyConfig, name: str) -> Path:
    """Where a model of the study lies."""
    return Path(config.output) / "models" / f"{file_name(name)}.pt"


def candidates(config: StudyConfig) -> Iterator[Candidate]:
    """Every simulator that the study's table compares.

    Raises:
        ValueError: A model has not been trained, or the fit has not been made.
    """
    for name, _, training in model_runs(config):
        model = load_model(model_file(config, name))[0]
        make = partial(make_engine, "learned", model=model)
        yield Candidate(name, make, 1 if training.preparation == "raw" else training.filter_width)
    fitted = Path(config.output) / fit_file(config)
    if not fitted.is_file():
        raise ValueError(f"there is no fit {fitted}: make it with scripts/fit_mujoco.py")
    named = {
        f"{config.fit_simulator}, as shipped": config.fit_simulator,
        f"{config.fit_simulator}, fitted": str(fitted),
        "single track, as shipped": "single_track",
        "kinematic bicycle": "kinematic",
        "hold last": "hold",
    }
    for name, simulator in (named | config.simulators).items():
        options = config.fit_options if simulator == config.fit_simulator else {}
        yield Candidate(name, partial(make_engine, simulator, **options))


def file_name(name: str) -> str:
    """A table name as a file name."""
    return "".join(c if c.isalnum() else "_" for c in name.lower()).strip("_")
