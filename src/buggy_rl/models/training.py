"""Training a dynamics model on drives: the original's one-step loss, or one over rollouts.

A model trained on single steps meets, in simulation, states that it made itself and never saw in
training (the original study's drift). The rollout loss closes that gap: the model runs for half a
second on its own states, and what is compared with the drive are velocities and poses on the way.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from buggy_rl.models.base import DynamicsModel
from buggy_rl.models.ensemble import Ensemble
from buggy_rl.models.losses import one_step_loss, rollout_loss
from buggy_rl.models.normalisation import fit_normalisation
from buggy_rl.recordings.recording import Recording
from buggy_rl.recordings.windows import Preparation, filtered, mirror, windows


@dataclass(frozen=True)
class TrainingConfig:
    """How a model is trained."""

    loss: Literal["one_step", "rollout"] = "rollout"
    """`one_step` is the original's; `rollout` compares what the model makes of its own states."""
    preparation: Preparation = "raw"
    """raw, filtered (causal past mean), mirrored (filtered, and left/right doubled)."""
    filter_width: int = 5
    """Rows of the past-mean filter, for filtered and mirrored."""
    horizon: int = 50
    """Steps of a training rollout once it has grown to full length."""
    stride: int = 5
    """Rows between the starts of neighbouring training rollouts."""
    batch_size: int = 256
    """Windows (or single steps) in a gradient step."""
    epochs: int = 60
    """Most passes over the data."""
    patience: int = 12
    """Stop after so many epochs without a better validation loss."""
    learning_rate: float = 2e-3
    """Adam's, decayed along a cosine to a hundredth; constant with the one-step loss."""
    weight_decay: float = 1e-5
    """Decoupled weight decay (AdamW) of the rollout loss."""
    seed: int = 0
    """Fixes initial weights and the order of the data."""


def prepared(recordings: Sequence[Recording], config: TrainingConfig) -> list[Recording]:
    """The drives as the preparation wants them; mirroring happens to windows, not here."""
    if config.preparation == "raw":
        return list(recordings)
    return [filtered(recording, config.filter_width) for recording in recordings]


class Training:
    """A training run that can be stopped after any epoch and goes on as if it never had been.

    Args:
        model: The model; its normalisation and envelope are fitted here.
        training: Drives to learn from.
        validation: Drives that decide when to stop.
        config: How.
    """

    def __init__(
        self,
        model: DynamicsModel,
        training: Sequence[Recording],
        validation: Sequence[Recording],
        config: TrainingConfig,
    ) -> None:
        self.model, self.config = model, config
        self.dt = training[0].dt
        horizon = 1 if config.loss == "one_step" else config.horizon
        length = model.rows + horizon  # history, and what follows it
        stride = 1 if config.loss == "one_step" else config.stride
        self.training = windows(prepared(training, config), length, stride)
        self.validation = windows(prepared(validation, config), length, max(stride, 5))
        if config.preparation == "mirrored":
            self.training = torch.cat([self.training, mirror(self.training)])
        fit_normalisation(model, self.training, training)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.optimiser = torch.optim.AdamW(
            model.parameters(),
            config.learning_rate,
            weight_decay=config.weight_decay if config.loss == "rollout" else 0.0,
        )
        self.epoch = 0
        self.best_loss = float("inf")
        self.best_epoch = 0
        self.best_weights = _copy(model.state_dict())

    def run(self) -> Iterator[dict[str, float]]:
        """Trains epoch by epoch, yielding `epoch`, `training_loss`, `validation_loss`.

        Afterwards the model has the weights of its best validation loss.

        Raises:
            FloatingPointError: The loss is no longer finite.
        """
        while not self.finished:
            self.epoch += 1
            training_loss = self._pass()
            validation_loss = self._validate()
            if validation_loss < self.best_loss:
                self.best_loss, self.best_epoch = validation_loss, self.epoch
                self.best_weights = _copy(self.model.state_dict())
            yield {
                "epoch": self.epoch,
                "training_loss": training_loss,
                "validation_loss": validation_loss,
            }
        self.model.load_state_dict(self.best_weights)

    @property
    def finished(self) -> bool:
        """Whether the last epoch has been trained, or patience has run out."""
        grown = self.epoch >= self._growth() + self.config.patience
        late = self.epoch - self.best_epoch >= self.config.patience
        return self.epoch >= self.config.epochs or (grown and late)

    def state_dict(self) -> dict[str, Any]:
        """Everything that a resumed run needs to go on bit for bit."""
        return {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "epoch": self.epoch,
            "best_loss": self.best_loss,
            "best_epoch": self.best_epoch,
            "best_weights": self.best_weights,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Goes back to where `state_dict` was taken."""
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"])
        self.epoch, self.best_loss = state["epoch"], state["best_loss"]
        self.best_epoch, self.best_weights = state["best_epoch"], state["best_weights"]

    def _growth(self) -> int:
        """Epochs over which the training rollout grows to its full length."""
        return 0 if self.config.loss == "one_step" else self.config.epochs // 4

    def _horizon(self) -> int:
        full, growth = self.config.horizon, self._growth()
        if self.config.loss == "one_step":
            return 1
        return full if self.epoch > growth else max(5, full * self.epoch // (growth + 1))

    def _pass(self) -> float:
        self.model.train()
        self._set_learning_rate()
        order = torch.randperm(len(self.training), generator=self.generator)
        losses = []
        for rows in order.split(self.config.batch_size):
            loss = self._loss(self.training[rows], self._horizon())
            if not torch.isfinite(loss):
                raise FloatingPointError(
                    f"the training loss is {loss.item()} in epoch {self.epoch}: lower "
                    f"training.learning_rate (now {self.config.learning_rate})"
                )
            self.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
            self.optimiser.step()
            losses.append(loss.detach())
        return torch.stack(losses).mean().item()

    def _set_learning_rate(self) -> None:
        if self.config.loss == "one_step":
            return
        done = torch.tensor(torch.pi * (self.epoch - 1) / self.config.epochs)
        share = 0.01 + 0.99 * 0.5 * (1 + torch.cos(done).item())
        for group in self.optimiser.param_groups:
            group["lr"] = share * self.config.learning_rate

    @torch.no_grad()
    def _validate(self) -> float:
        self.model.eval()
        horizon = 1 if self.config.loss == "one_step" else self.config.horizon
        total = sum(
            self._loss(part, horizon).item() * len(part) for part in self.validation.split(2048)
        )
        return total / len(self.validation)

    def _loss(self, batch: TensorDictBase, horizon: int) -> Tensor:
        # The members of an ensemble learn apart, so that their spread means something.
        members = self.model.members if isinstance(self.model, Ensemble) else [self.model]
        if self.config.loss == "one_step":
            losses = [one_step_loss(member, batch) for member in members]
        else:
            losses = [rollout_loss(member, batch, horizon, self.dt) for member in members]
        return torch.stack(losses).mean()


def _copy(state: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.clone() for name, tensor in state.items()}
