"""Training of models and of policies, with logs and checkpoints from which it goes on."""

import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import torch

from buggy_rl.api.drives import Drives, drives_of
from buggy_rl.core.config import from_python, made_by, plain_values, save_run
from buggy_rl.core.files import load_torch, save_torch
from buggy_rl.core.question import refuse_another, schema
from buggy_rl.core.run_log import RunLog
from buggy_rl.estimation.fit_study import ModelRunConfig
from buggy_rl.policies.training.run import PolicyRun, PolicyRunConfig
from buggy_rl.policies.training.trainer import NonFiniteLossError
from buggy_rl.recordings import Recording
from buggy_rl.simulators.learned import training as model_training
from buggy_rl.simulators.learned.factory import ModelConfig, load_about, make_model, save_model
from buggy_rl.simulators.learned.training import Training

AGAIN = "fresh=true trains it again"
Draw = Callable[[Path, Mapping[str, float]], dict[str, Path]]
"""Draws pictures of what a folder holds, for its metrics; their files by name."""


def train_model(
    recordings: Drives,
    validation: Drives,
    file: str | Path,
    *,
    model: str | Mapping[str, Any] = "mlp",
    columns: str | Path | None = None,
    car: str = "",
    fresh: bool = False,
    wandb: bool = False,
    **settings: Any,
) -> Path:
    """Trains a model of a car, which is then a simulator: `make_simulator("model.pt")`.

    Started again it goes on from its checkpoint, and does nothing where the file is there.

    Args:
        recordings: To train on: recordings, or their paths.
        validation: To stop by.
        file: The model's, a .pt; its log lies in the folder of that name.
        model: mlp, temporal_cnn, gru or transformer, or the fields of `ModelConfig`.
        columns: How tables are read.
        car: Name or file of the car, whose limits hold for the recordings.
        fresh: Trains again what is there.
        wandb: Tells Weights & Biases too.
        settings: Fields of `TrainingConfig`: loss, epochs, preparation, seed, and so on.

    Returns:
        The model's file.

    Raises:
        ValueError: A setting is unknown, the recordings cannot be used, or the file is there and
            was trained otherwise.
    """
    kind = {"kind": model} if isinstance(model, str) else model
    own = ModelRunConfig(
        from_python(ModelConfig, kind, "train_model, model"),
        from_python(model_training.TrainingConfig, settings, "train_model"),
    )
    drives = [drives_of(d, warnings.warn, columns, car=car) for d in (recordings, validation)]
    run = ModelRun(own, drives[0], drives[1], Path(file), fresh)
    if not run.done:
        for _ in run.metrics(wandb):
            pass
    return run.file


class ModelRun:
    """The training of one model: its file, and its log and checkpoint beside it.

    Args:
        config: The model and how it is trained.
        training: Recordings to train on.
        validation: Recordings to stop by.
        file: The model's.
        fresh: Trains it again where it is there.

    Raises:
        ValueError: It is there, and was trained otherwise.
    """

    def __init__(
        self,
        config: ModelRunConfig,
        training: Sequence[Recording],
        validation: Sequence[Recording],
        file: Path,
        fresh: bool = False,
    ) -> None:
        self.config, self.file, self._fresh = config, file, fresh
        self._drives = (training, validation)
        self._asked = model_training.model_question(
            config.model, config.training, training, validation
        )
        self._checkpoint = file.with_suffix(".checkpoint")
        self.done = file.exists() and not fresh
        if self.done:
            refuse_another(load_about(file)[1].get("question"), self._asked, str(file), AGAIN)

    def metrics(
        self, wandb: bool = False, draw: Callable[[Path], dict[str, Path]] | None = None
    ) -> Generator[dict[str, float], None, None]:
        """Trains, and yields `epoch`, `training_loss` and `validation_loss` of every epoch.

        Args:
            wandb: Whether Weights & Biases is told.
            draw: Draws the trained model of a file; pictures by name.

        Raises:
            ValueError: The checkpoint is that of another training.
        """
        own = self.config.training
        torch.manual_seed(own.seed)
        model = make_model(self.config.model)
        run = Training(model, *self._drives, own)
        half_done = {**self._asked, "schema": schema(model_training.SCHEMA)}
        resume = self._checkpoint.exists() and not self._fresh
        if resume:
            state = load_torch(self._checkpoint)
            refuse_another(state.pop("question", None), half_done, str(self._checkpoint), AGAIN)
            run.load_state_dict(state)
        folder = self.file.with_suffix("")
        logged = {**made_by(), **plain_values(self.config)}
        at = run.epoch if resume else None
        with closing(RunLog(folder, "epoch", logged, wandb, at)) as log:
            for metrics in run.run():
                log.add(metrics)
                log.write()
                save_torch(self._checkpoint, {**run.state_dict(), "question": half_done})
                yield metrics
            save_model(model, self.config.model, self.file, self._about(own))
            save_run(self.config, folder)
            if draw is not None:
                log.add({"epoch": run.epoch}, draw(self.file))
                log.write()
        self._checkpoint.unlink(missing_ok=True)

    def _about(self, own: model_training.TrainingConfig) -> dict[str, Any]:
        training, validation = self._drives
        return {
            "dt": training[0].dt,
            "training": plain_values(own),
            "drives": [r.name for r in (*training, *validation)],
            "question": self._asked,
        }


def train_policy(
    simulator: str | Path,
    output: str | Path,
    *,
    files: Sequence[str | Path] = ("configs/ppo.yaml",),
    **settings: Any,
) -> Path:
    """Trains a policy by PPO to drive along waypoints in a simulator.

    Args:
        simulator: An engine's name, a .yaml, a .pt or file.py:factory.
        output: Folder for the policy, its checkpoint and its log.
        files: YAML files of settings; by default those that the package ships.
        settings: Fields of `PolicyRunConfig`, nested or dotted: seed, resume, wandb, ppo, task, and
            so on: `train_policy("mujoco", "runs/p", ppo={"steps": 1_000_000})`.

    Returns:
        The policy that was best on the selection paths, which `load_policy` reads.

    Raises:
        ValueError: A setting is unknown, or the folder has another run's checkpoint.
    """
    given = {**settings, "output": output, "engine.simulator": simulator}
    config = from_python(PolicyRunConfig, given, "train_policy", files)
    for _ in policy_metrics(PolicyRun(config)):
        pass
    return Path(config.output) / "best.pt"


def policy_metrics(
    run: PolicyRun, draw: Draw | None = None
) -> Generator[dict[str, float], None, None]:
    """Trains a policy, with its log and its checkpoints; yields the metrics of every batch.

    Args:
        run: The training.
        draw: Draws the policy that was just validated.

    Raises:
        NonFiniteLossError: A loss is not finite; the row of its batch is in the log.
    """
    config, folder = run.config, run.folder
    about = {**made_by(), **plain_values(config)}
    at = run.trainer.steps if config.resume else None
    log = RunLog(folder, "steps", about, config.wandb, at)
    if not (folder / "best.pt").exists():  # else it is written with the first policy
        save_run(config, folder)
    with closing(run), closing(log):
        try:
            for metrics in run.metrics():
                validated = "validation_waypoints" in metrics
                log.add(metrics, draw(folder, metrics) if draw and validated else None)
                if run.checkpoint_is_due:
                    log.write()  # just before the checkpoint, so that a resumed log repeats none
                    run.checkpoint()
                yield metrics
        except NonFiniteLossError as error:
            log.add(error.metrics)
            log.write()
            raise
