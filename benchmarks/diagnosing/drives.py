"""Drives of a car that is known to be off, as a person would hand them in: files."""

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import torch
from tensordict import TensorDict
from torchrl.envs import EnvBase

from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.recordings import Recording, load_recordings, save_recording
from buggy_rl.recordings.camera import Camera
from buggy_rl.simulators.learned.factory import ModelConfig, make_model, save_model
from buggy_rl.simulators.learned.training import Training, TrainingConfig
from buggy_rl.task.env import make_simulator
from diagnosing.job import Job

CHANGED, RIGHT, LESSONS, OFF = "changed", "right", "lessons", "off"  # folders, and kinds of drives
COUNT = 2  # drives that a diagnosis is given, and as many of the baseline
SPARE = 0.1  # [s] driven beyond what is asked for: reading a file may cost a row
LESSON_COUNT = 6  # drives that a model learns from, the last of which says when to stop
SEEDS = {CHANGED: 0, RIGHT: 1, LESSONS: 2, OFF: 3}  # so that no two drives are alike


def make_drives(job: Job) -> None:
    """Drives the cars of one kind and writes what their cameras saw."""
    config = job.config
    count = LESSON_COUNT if job.name == LESSONS else COUNT
    engine = car(job.name, count, config.dead_time, {config.parameter: config.truth})
    seconds = job.seconds / COUNT + SPARE
    record(engine, job.file(job.name), seconds, seed=10 * config.seed + SEEDS[job.name])


def car(
    kind: str, count: int, dead_time: float, parameters: Mapping[str, float] | None = None
) -> EnvBase:
    """The cars that are driven."""
    if kind == OFF:
        return make_simulator("mujoco", count, parameters=parameters)
    if kind == CHANGED:
        faults = {"steering_dead_time": {"dead_time": dead_time}}
        return make_simulator("reference", count, faults=faults)
    return make_simulator("reference", count)


@torch.no_grad()
def record(engine: EnvBase, folder: Path, seconds: float, seed: int) -> None:
    """Drives about the room, all cars at once."""
    rows = list(recorded_steps(engine, RoomDriver(seed=seed), round(seconds / CONTROL_PERIOD)))
    camera = Camera(seed=seed)
    folder.mkdir(parents=True, exist_ok=True)
    true = cast(TensorDict, TensorDict.stack(rows, 1))  # (N, T)
    for index, drive in enumerate(true.unbind(0)):
        name = f"drive_{index:02d}"
        recording = Recording(name, camera.recorded(drive), CONTROL_PERIOD)
        save_recording(recording, folder / f"{name}.csv")


def load(folder: Path, seconds: float = 0.0) -> list[Recording]:
    """Drives of a folder; their first `seconds` altogether, in equal parts, where given.

    Raises:
        ValueError: A drive was refused, or all of them are shorter than that.
    """
    recordings, refusals = load_recordings([str(folder)])
    if refusals:
        raise ValueError(f"{folder}: {refusals[0]}")
    rows = round(seconds / len(recordings) / CONTROL_PERIOD)
    if any(len(r) < rows for r in recordings):
        raise ValueError(f"{folder}: a drive is shorter than {seconds / len(recordings):g} s")
    if not rows:
        return recordings
    return [Recording(r.name, r.data[:rows].clone(), r.dt) for r in recordings]


def make_model_file(job: Job) -> None:
    """Trains a history MLP on drives of the right car."""
    lessons = load(job.file(LESSONS))
    config = ModelConfig("mlp", options={"rows": 5})
    torch.manual_seed(job.config.seed)
    model = make_model(config)
    settings = TrainingConfig(epochs=job.config.epochs, seed=job.config.seed)
    for _ in Training(model, lessons[:-1], lessons[-1:], settings).run():
        pass
    about = {"dt": CONTROL_PERIOD, "drives": [r.name for r in lessons]}
    save_model(model, config, job.file("model.pt"), about)
