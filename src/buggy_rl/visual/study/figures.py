"""The figures of a study: where the data of each are, and what draws them.

A figure whose data are not there yet is skipped with the command that makes them.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.estimation.fit_study import StudyConfig, load_drives, model_file, model_runs
from buggy_rl.estimation.open_loop import (
    MEASURED,
    Rollouts,
    load_rollouts,
    measured_motion,
    median_error,
)
from buggy_rl.estimation.table import ComparedSimulator, held_out_segments, rollout_errors
from buggy_rl.figures.drives import (
    Bundles,
    PlottedSignals,
    bundles_figure,
    histogram_figure,
    repair_figure,
    signals_figure,
)
from buggy_rl.figures.models import training_figure
from buggy_rl.figures.policies import learning_figure, paths_figure, policies_figure
from buggy_rl.policies.evaluation.drives import ShowPoliciesConfig, policy_panels
from buggy_rl.policies.training.seeds import ShowLearningConfig, curves, read_log
from buggy_rl.recordings import Recording
from buggy_rl.recordings.resampling import filtered
from buggy_rl.recordings.windows import mirror
from buggy_rl.task.env import make_simulator
from buggy_rl.task.paths.making import ShowPathsConfig, path_sets

SEGMENTS = 12  # of a bundle; more of them hide one another


def model_bundles(model: Path, filter_width: int, recording: Recording, picture: Path) -> None:
    """Draws open-loop rollouts of a model over a recording.

    Args:
        model: Its file.
        filter_width: Rows of the past mean that its starts are filtered by; 1 for none.
        recording: That it was not trained on.
        picture: The file that is written.
    """
    test = held_out_segments([recording], SEGMENTS)
    name = model.stem
    made, _ = rollout_errors(
        ComparedSimulator(name, partial(make_simulator, str(model)), filter_width), test
    )
    driven = np.asarray(measured_motion(test.segments).get(keys.POSE))
    time = test.segments.dt * np.arange(driven.shape[1])
    rollouts = {name: np.asarray(made.get(keys.POSE))}
    bundles_figure(Bundles(recording.name, time, driven, rollouts)).savefig(picture, dpi=110)


SIGNAL_SECONDS = 2.0  # [s] of the recording whose signals are drawn
FILTER_WIDTH = 5  # rows, of the original study
LOSSES = "training_loss", "validation_loss"
COLUMNS = 4  # simulators beside one another that are readable in print


class MissingError(ValueError):
    """What a figure shows is not there; the message says what makes it."""


@dataclass(frozen=True)
class FiguresConfig(StudyConfig):
    """Which figures of a study are drawn, and what they show beside its recordings and models."""

    draw: list[str] = field(default_factory=list)
    """Figures, of `FIGURES`; empty for all."""
    folder: str = ""
    """Folder for the figures; empty for OUTPUT/figures."""
    repair: str = ""
    """Folder of the table before and after a repair; empty for OUTPUT/repair."""
    learning: ShowLearningConfig = field(default_factory=ShowLearningConfig)
    policies: ShowPoliciesConfig = field(default_factory=ShowPoliciesConfig)
    paths: ShowPathsConfig = field(default_factory=ShowPathsConfig)


def _driven(config: FiguresConfig) -> Figure:
    """Recorded velocities and commands of the training recordings, and mirrored."""
    keep = (keys.POSE, keys.VELOCITY, keys.ACTION)
    training = load_drives(config.data, _ignore, config.car).training
    rows: TensorDict = TensorDict.cat([r.data.select(*keep) for r in training])  # type: ignore[assignment]
    both: TensorDict = TensorDict.cat([rows, mirror(rows)])  # type: ignore[assignment]
    return histogram_figure({"as driven": rows, "and mirrored": both})


def signals(config: FiguresConfig) -> Figure:
    """Raw and filtered velocities, and their labels, where the first held-out drive turns most."""
    recording = load_drives(config.data, _ignore, config.car).held_out[0]
    smooth = filtered(recording, FILTER_WIDTH)
    count = round(SIGNAL_SECONDS / recording.dt)
    if len(recording) < count:
        raise MissingError(f"{recording.name} is shorter than {SIGNAL_SECONDS:g} s")
    turning = recording.data[keys.VELOCITY][:, 2].unfold(0, count, 1).std(-1)
    rows = slice(first := int(turning.argmax()), first + count)
    time = recording.data[keys.TIME].flatten().numpy()[rows]
    raw, past = (r.data[keys.VELOCITY][rows].numpy() for r in (recording, smooth))
    return signals_figure(PlottedSignals(time, raw, past, recording.dt, FILTER_WIDTH))


def _training(config: FiguresConfig) -> Figure:
    """Losses over the epochs, by model and preparation."""
    logs: dict[str, dict[str, pd.DataFrame]] = {}
    for name, _, run in model_runs(config):
        folder = model_file(config, name).with_suffix("")
        if (folder / "csv").is_dir():
            model = name.removesuffix(f", {run.preparation}")
            losses = {metric: read_log(folder, metric) for metric in LOSSES}
            logs.setdefault(model, {})[run.preparation] = pd.DataFrame(losses)
    if not logs:
        raise MissingError("no losses: scripts/train_models.py writes them")
    return training_figure(logs)


def bundles(config: FiguresConfig) -> Figure:
    """Open-loop rollouts of every simulator over one held-out recording."""
    file = Path(config.output) / "rollouts.npz"
    if not file.is_file():
        raise MissingError(f"no {file}: scripts/evaluate_models.py writes it")
    rollouts = load_rollouts(file)
    recording = rollouts.recording[0]
    own = [i for i, name in enumerate(rollouts.recording) if name == recording]
    kept = own[:: max(1, len(own) // SEGMENTS)][:SEGMENTS]
    made = {name: rollouts.pose[name][kept] for name in config.shown or _best(rollouts)}
    return bundles_figure(Bundles(recording, rollouts.time, rollouts.pose[MEASURED][kept], made))


def paths(config: FiguresConfig) -> Figure:
    """Training and validation paths, lap, infinity, circle, tight."""
    return paths_figure(path_sets(config.paths), config.paths.shown, config.paths.waypoints)


def learning(config: FiguresConfig) -> Figure:
    """Learning curves of policies, with the band of their seeds."""
    if not config.learning.runs:
        raise MissingError("no runs: learning.runs.NAME=[FOLDER] of scripts/train_policy.py")
    return learning_figure(curves(config.learning))


def policies(config: FiguresConfig) -> Figure:
    """Drives of policies in their simulators and on the reference car."""
    if not config.policies.policies:
        raise MissingError("no policies: policies.policies.NAME=FILE of scripts/train_policy.py")
    return policies_figure(list(policy_panels(config.policies)))


def repair(config: FiguresConfig) -> Figure:
    """Errors of the simulator as given and repaired."""
    file = Path(config.repair or Path(config.output) / "repair") / "table.csv"
    if not file.is_file():
        raise MissingError(
            f"no {file}: scripts/study.py writes it, or scripts/evaluate_models.py with "
            "simulators.fitted=... simulators.repaired=... output=FOLDER"
        )
    table = pd.read_csv(file)
    shown = table.loc[table["simulator"].isin(["fitted", "repaired"]).to_numpy()]
    return repair_figure(shown.to_dict("records"))  # pyrefly: ignore[bad-argument-type]


FIGURES: dict[str, Callable[[FiguresConfig], Figure]] = {
    "driven": _driven,
    "signals": signals,
    "training": _training,
    "bundles": bundles,
    "paths": paths,
    "learning": learning,
    "policies": policies,
    "repair": repair,
}
"""Name -> what gathers its data and draws it."""


def _best(rollouts: Rollouts) -> list[str]:
    """The simulators of smallest median error at the end, best first."""
    names = [name for name in rollouts.pose if name != MEASURED]
    return sorted(names, key=lambda name: median_error(rollouts, name))[:COLUMNS]


def _ignore(refusal: str) -> None:
    """Refused recordings are told by every script that trains or judges."""
