"""A study: which drives, which models trained how, which simulators beside them."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from omegaconf import MISSING

from buggy_rl.core.config import belongs_to, plain_values
from buggy_rl.core.question import CONTENT, Question, contents, question, refuse_another
from buggy_rl.estimation.least_squares import FitConfig
from buggy_rl.estimation.table import ComparedSimulator
from buggy_rl.recordings import load_recordings
from buggy_rl.recordings.loading import doubtful
from buggy_rl.recordings.recording import Recording
from buggy_rl.recordings.resampling import Preparation
from buggy_rl.recordings.windows import split
from buggy_rl.simulators import ENGINES, as_car
from buggy_rl.simulators.learned.factory import ModelConfig, load_about, load_model
from buggy_rl.simulators.learned.training import TrainingConfig
from buggy_rl.task.env import make_simulator

FIT = ("car", "fit", "fit_simulator", "fit_options")  # of the config: what a fit depends on


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
    preparations: list[Preparation] = field(default_factory=list)
    """Any of raw, filtered, mirrored, each a row of the table; empty for the training's own."""


@dataclass(frozen=True)
class ModelRunConfig:
    """One model and its training."""

    model: ModelConfig
    training: TrainingConfig


@dataclass(frozen=True)
class StudyConfig:
    """Everything from drives to the table of simulators."""

    output: str = MISSING
    """Folder for models, fits, table and pictures."""
    car: str = ""
    """The car: a name in configs/cars or a file of one's own; empty for the buggy's ranges."""
    data: DataConfig = field(default_factory=DataConfig)
    runs: dict[str, RunConfig] = field(default_factory=dict)
    """Models to train, by the name they have in the table."""
    fit: FitConfig = field(default_factory=FitConfig)
    fit_simulator: str = "mujoco"
    """The simulator that scripts/fit_mujoco.py fits: any that declares parameters."""
    fit_options: dict[str, Any] = field(default_factory=dict, metadata=belongs_to("fit_simulator"))
    """Further arguments of that simulator's class, such as tyres: contact, dimensions: {wheelbase:
    0.26, mass: 3.0} or ranges: {mass: [1.0, 4.0]}."""
    simulators: dict[str, str] = field(default_factory=dict)
    """Further simulators for the table, by the name they have in it."""
    windows: int = 300
    """Most held-out windows that the table is made over; at least 2."""
    threads: int = 1
    """Threads of PyTorch."""
    only: list[str] = field(default_factory=list)
    """Train and judge only these models, by their name in the table."""
    shown: list[str] = field(default_factory=list)
    """Simulators whose rollouts are drawn; empty for the best three."""
    wandb: bool = False
    """Tells Weights & Biases of training too, offline unless WANDB_MODE says otherwise."""
    media: bool = False
    """Draws rollouts of each trained model over a validation drive, in its log too."""


@dataclass(frozen=True)
class StudyDrives:
    """Drives by what they are used for."""

    training: list[Recording]
    validation: list[Recording]
    held_out: list[Recording]


def load_drives(
    config: DataConfig, on_refusal: Callable[[str], None], car: str = ""
) -> StudyDrives:
    """Reads a study's drives and splits them; what is refused or doubtful is told, one line each.

    Args:
        config: Which.
        on_refusal: Told of each that is refused, and of what may be wrong with the others.
        car: Name or file of the car that the checks are for.

    Raises:
        ValueError: Too few drives are left.
    """
    recordings, refusals = load_recordings(config.recordings, config.columns or None, car=car)
    for refusal in refusals:
        on_refusal(str(refusal))
    for recording in recordings:
        for note in doubtful(recording.notes):
            on_refusal(f"{recording.name}: {note}")
    if not recordings:
        raise ValueError(f"no drive could be read from {', '.join(config.recordings)}")
    return divide(recordings, config)


def divide(recordings: list[Recording], config: DataConfig) -> StudyDrives:
    """Splits by whole drives into training, validation and held out.

    Raises:
        ValueError: A name is not there, or there are too few drives.
    """
    known = {r.name for r in recordings}
    missing = sorted(set(config.leave_out) - known)
    if missing:
        raise ValueError(f"cannot leave out {missing}: the drives are {sorted(known)}")
    kept = [r for r in recordings if r.name not in config.leave_out]
    if len(kept) < 3:
        raise ValueError(
            f"{len(kept)} drive(s) are too few: one to train on, one to stop training by and one "
            "to judge by are needed; record more, or cut a long one in parts"
        )
    rest, held_out = split(kept, config.held_out or config.held_out_share, config.seed)
    training, validation = split(rest, config.validation or 1 / len(rest), config.seed)
    return StudyDrives(training, validation, held_out)


def model_runs(config: StudyConfig) -> Iterator[tuple[str, ModelConfig, TrainingConfig]]:
    """Every model of a study that `only` does not leave out: its name, what it is, its training.

    Raises:
        ValueError: `only` names a model that is not there.
    """
    runs = list(_all_runs(config))
    names = [name for name, _, _ in runs]
    unknown = sorted(set(config.only) - set(names))
    if unknown:
        raise ValueError(f"only={unknown}: the models are {names}")
    yield from (run for run in runs if not config.only or run[0] in config.only)


def _all_runs(config: StudyConfig) -> Iterator[tuple[str, ModelConfig, TrainingConfig]]:
    for name, run in config.runs.items():
        if not run.preparations:
            yield name, run.model, run.training
        for preparation in run.preparations:
            training = replace(run.training, preparation=preparation)
            yield f"{name}, {preparation}", run.model, training


def fit_setup(config: StudyConfig) -> dict[str, dict[str, Any]]:
    """`options` and `parameters` of the simulator that is fitted: the car's, then its own."""
    made = simulator_setup(config, config.fit_simulator)
    return {**made, "options": {**made["options"], **config.fit_options}}


def simulator_setup(config: StudyConfig, simulator: str) -> dict[str, dict[str, Any]]:
    """`options` and `parameters` that make one of our engines the study's car."""
    if not config.car or simulator not in ENGINES:  # a file says itself what it is
        return {"options": {}, "parameters": {}}
    return as_car(simulator, config.car)


def fit_file(config: StudyConfig) -> str:
    """Name of the fitted simulator's file in the study's output folder."""
    return f"{file_name(config.fit_simulator)}_fitted.yaml"


def fit_question(config: StudyConfig, drives: StudyDrives) -> Question:
    """What a fitted simulator depends on: settings of the fit, content of the training drives."""
    settings = plain_values(config)
    return question({name: settings[name] for name in FIT}, drives.training)


def refuse_other_drives(config: StudyConfig, drives: StudyDrives) -> None:
    """Compares what lies in a study's folder with the drives that the study reads now.

    A fit must be of the same settings and training drives. A model must have been trained on no
    drive that has other content now; its settings are compared by `compared_simulators`.

    Raises:
        ValueError: Something was made from other drives; the message says what to run.
    """
    fitted = Path(config.output) / fit_file(config)
    if fitted.is_file():
        was = yaml.safe_load(fitted.read_text()).get("_question")
        refuse_another(was, fit_question(config, drives), str(fitted), "fit it anew: fit_mujoco.py")
    now = _digests(contents([*drives.training, *drives.validation, *drives.held_out]))
    for name, _, _ in model_runs(config):
        file = model_file(config, name)
        was = _digests(load_about(file)[1].get("question", {}))
        both = {drive: digest for drive, digest in now.items() if drive in was}
        used = {drive: was[drive] for drive in both}
        refuse_another(used, both, str(file), "train it anew (train_models.py, fresh=true)")


def _digests(asked: Question) -> Question:
    """The digests of recordings in a question, whether trained on or validated with."""
    recordings = (f"{CONTENT}recording ", f"{CONTENT}validation recording ")
    return {
        f"{recordings[0]}{name.removeprefix(start)}": digest
        for name, digest in asked.items()
        for start in recordings
        if name.startswith(start)
    }


def model_file(config: StudyConfig, name: str) -> Path:
    """File of a model of the study."""
    return Path(config.output) / "models" / f"{file_name(name)}.pt"


def compared_simulators(
    config: StudyConfig, held_out: Collection[str]
) -> Iterator[ComparedSimulator]:
    """Every simulator that the study's table compares; `held_out` names the drives that judge.

    Raises:
        ValueError: A model has not been trained, with another config, or on a drive that judges.
    """
    held_out = set(held_out)
    for name, kind, training in model_runs(config):
        file = model_file(config, name)
        model, about = load_model(file)
        was = question({"model": load_about(file)[0], "training": about["training"]})
        now = question({"model": plain_values(kind), "training": plain_values(training)})
        refuse_another(was, now, str(file), "train it anew (train_models.py, fresh=true)")
        leaked = sorted(set(about["drives"]) & held_out)
        if leaked:
            raise ValueError(f"{name} was trained on {leaked}, which now judge: train it anew")
        make = partial(make_simulator, "learned", model=model)
        yield ComparedSimulator(
            name, make, 1 if training.preparation == "raw" else training.filter_width
        )
    named = {
        f"{config.fit_simulator}, as shipped": config.fit_simulator,
        f"{config.fit_simulator}, fitted": str(Path(config.output) / fit_file(config)),
        "single track, as shipped": "single_track",
        "kinematic bicycle": "kinematic",
        "hold last": "hold",
    }
    if config.fit_simulator == "single_track":  # it is there as what was fitted, as shipped
        del named["single track, as shipped"]
    for name, simulator in (named | config.simulators).items():
        own = simulator == config.fit_simulator
        made = fit_setup(config) if own else simulator_setup(config, simulator)
        given = partial(make_simulator, parameters=made["parameters"] or None, **made["options"])
        yield ComparedSimulator(name, partial(given, simulator))


def file_name(name: str) -> str:
    """A table name as a file name."""
    return "".join(c if c.isalnum() else "_" for c in name.lower()).strip("_")
