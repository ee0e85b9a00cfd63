"""Training of dynamics models, with the original study's one-step loss or a rollout loss.

In simulation a model runs on its own predictions, a distribution that single training steps do not
have (the original study's drift). The rollout loss trains on it: the model runs for half a second
on its own states, and its velocities and poses are compared with the recording.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from buggy_rl.core import keys
from buggy_rl.core.question import Question, contents, question
from buggy_rl.core.vehicle import integrate_pose
from buggy_rl.recordings.recording import Recording
from buggy_rl.recordings.resampling import Preparation, filtered
from buggy_rl.recordings.windows import mirror, model_inputs, relative_pose, windows
from buggy_rl.simulators.learned.base import DynamicsModel, Ensemble
from buggy_rl.simulators.learned.normalisation import fit_normalisation

VELOCITY_WEIGHT = 4.0  # of the velocity error over the pose error; both of order one; chosen
POSE_SCALE = 0.02  # [m] and [rad] pose error that counts as one at the start; chosen
POSE_GROWTH = 0.2  # [s] after which twice `POSE_SCALE` counts as one: errors grow; chosen


def one_step_loss(model: DynamicsModel, batch: TensorDictBase) -> Tensor:
    """Mean squared error of the normalised change of velocity, as in the original study.

    Windows are [B, rows + 1] or longer: `rows` of input, then the label.
    """
    history = model_inputs(batch)[:, : model.rows]
    velocity = batch[keys.VELOCITY]
    label = velocity[:, model.rows] - velocity[:, model.rows - 1]  # (B, 3)
    error = (model.change(history) - label) / model.output_scale
    return error.square().mean()


def rollout_loss(model: DynamicsModel, batch: TensorDictBase, horizon: int, dt: float) -> Tensor:
    """Error of velocity and pose along `horizon` steps on the model's own states.

    L = VELOCITY_WEIGHT H((v - v_m) / s_v) + H((p - p_m) / (POSE_SCALE (1 + t / POSE_GROWTH))),
    with H the mean Huber loss, which is insensitive to glitches of the camera, and s_v the
    standard deviation of the velocities. Windows are [B, rows + horizon] or longer; dt in [s].
    """
    rows, data = model.rows, model_inputs(batch)
    history, velocity = data[:, :rows], data[:, rows - 1, :3]
    pose = torch.zeros_like(velocity)  # in the frame of the first pose
    measured_pose = relative_pose(batch[keys.POSE][:, rows - 1 :])  # (B, horizon + 1, 3)
    speed_scale = model.input_scale[:3]
    elapsed = torch.arange(1, horizon + 1) * dt
    velocities, poses = [], []
    for step in range(horizon):
        following = velocity + model.change(history)
        pose = integrate_pose(pose, velocity, following, dt)
        velocities.append(following)
        poses.append(pose)
        if step < horizon - 1:
            row = torch.cat([following, data[:, rows + step, 3:]], -1)
            history = torch.cat([history[:, 1:], row.unsqueeze(1)], 1)
        velocity = following
    speed_error = (torch.stack(velocities, 1) - data[:, rows : rows + horizon, :3]) / speed_scale
    allowed = POSE_SCALE * (1 + elapsed / POSE_GROWTH).unsqueeze(-1)  # [m], and [rad] for yaw
    pose_error = (torch.stack(poses, 1) - measured_pose[:, 1 : horizon + 1]) / allowed
    return VELOCITY_WEIGHT * _huber(speed_error) + _huber(pose_error)


def _huber(error: Tensor) -> Tensor:
    return nn.functional.huber_loss(error, torch.zeros_like(error))


FIRST_HORIZON = 5  # [steps] shortest training rollout while the horizon grows; chosen
LAST_RATE = 0.01  # of the initial learning rate, at the end of the cosine decay; chosen
LARGEST_GRADIENT = 1.0  # norm of a gradient step, clipped above; the losses are of order one
VALIDATION_STRIDE = 5  # [rows] least distance of validation rollouts: neighbours are alike
VALIDATION_BATCH = 2048  # rollouts in a validation batch; bounds the memory
SCHEMA = 1  # of checkpoints: raised when other code would not go on from them
PROGRESS = ("epoch", "best_loss", "best_epoch", "best_weights")  # attributes saved with a run


@dataclass(frozen=True)
class TrainingConfig:
    """How a model is trained."""

    loss: Literal["one_step", "rollout"] = "rollout"
    """`one_step`: the original study's; `rollout`: over the model's own states."""
    preparation: Preparation = "raw"
    """raw, filtered (causal past mean), mirrored (filtered, plus the left/right mirror)."""
    filter_width: int = 5
    """Rows of the past-mean filter of filtered and mirrored."""
    horizon: int = 50
    """Steps of a training rollout at its full length."""
    stride: int = 5
    """Rows between the starts of consecutive training rollouts."""
    batch_size: int = 256
    """Rollouts (or single steps) in a gradient step."""
    epochs: int = 60
    """Maximum number of epochs."""
    patience: int = 12
    """Epochs without a better validation loss after which training stops."""
    learning_rate: float = 2e-3
    """Learning rate of Adam; cosine decay to a hundredth with the rollout loss, constant with
    one_step."""
    weight_decay: float = 1e-5
    """Decoupled weight decay (AdamW) with the rollout loss."""
    seed: int = 0
    """Seed of the initial weights and the order of the data."""


def model_question(
    model: Any,
    config: TrainingConfig,
    training: Sequence[Recording],
    validation: Sequence[Recording],
) -> Question:
    """What a trained model depends on; `model` is its config."""
    own = question({"model": asdict(model), "training": asdict(config)}, training)
    return own | contents(validation, "validation recording")


def _prepared(recordings: Sequence[Recording], config: TrainingConfig) -> list[Recording]:
    """Filters recordings if the preparation does; mirroring is applied to windows."""
    if config.preparation == "raw":
        return list(recordings)
    return [filtered(recording, config.filter_width) for recording in recordings]


class Training:
    """A training run that can be stopped after any epoch and resumed bit for bit.

    Args:
        model: The model; its normalisation and envelope are fitted here.
        training: Recordings to train on.
        validation: Recordings that decide when to stop.
        config: Loss, data and optimiser.
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
        one_step = config.loss == "one_step"
        self.horizon = 1 if one_step else config.horizon
        self.growth = 0 if one_step else config.epochs // 4  # epochs until the full horizon
        length = model.rows + self.horizon  # history, then the rollout
        stride = 1 if one_step else config.stride
        self.training = windows(_prepared(training, config), length, stride)
        self.validation = windows(
            _prepared(validation, config), length, max(stride, VALIDATION_STRIDE)
        )
        if config.preparation == "mirrored":
            self.training = torch.cat([self.training, mirror(self.training)])
        fit_normalisation(model, self.training, training)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.optimiser = torch.optim.AdamW(
            model.parameters(),
            config.learning_rate,
            weight_decay=0.0 if one_step else config.weight_decay,
        )
        self.epoch = 0
        self.best_loss = float("inf")
        self.best_epoch = 0
        self.best_weights = _copy(model.state_dict())

    def run(self) -> Iterator[dict[str, float]]:
        """Trains epoch by epoch, yielding `epoch`, `training_loss`, `validation_loss`.

        At the end the model has the weights of the lowest validation loss.

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
            losses = {"training_loss": training_loss, "validation_loss": validation_loss}
            yield {"epoch": self.epoch, **losses}
        self.model.load_state_dict(self.best_weights)

    @property
    def finished(self) -> bool:
        """Whether all epochs are trained, or patience has run out."""
        grown = self.epoch >= self.growth + self.config.patience
        late = self.epoch - self.best_epoch >= self.config.patience
        return self.epoch >= self.config.epochs or (grown and late)

    def state_dict(self) -> dict[str, Any]:
        """State from which a run resumes bit for bit."""
        return {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            **{name: getattr(self, name) for name in PROGRESS},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores a state of `state_dict`."""
        self.model.load_state_dict(state["model"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.generator.set_state(state["generator"])
        for name in PROGRESS:
            setattr(self, name, state[name])

    def _horizon(self) -> int:
        """Steps of a training rollout, which grows over the first epochs."""
        if self.epoch > self.growth:
            return self.horizon
        return max(FIRST_HORIZON, self.horizon * self.epoch // (self.growth + 1))

    def _pass(self) -> float:
        self.model.train()
        self._set_learning_rate()
        order = torch.randperm(len(self.training), generator=self.generator)
        losses = []
        for rows in order.split(self.config.batch_size):
            loss = self._loss(self.training[rows], self._horizon())
            if not torch.isfinite(loss):
                raise FloatingPointError(
                    f"training loss {loss.item()} in epoch {self.epoch} is not finite; lower "
                    f"training.learning_rate, now {self.config.learning_rate}"
                )
            self.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            nn.utils.clip_grad_norm_(self.model.parameters(), LARGEST_GRADIENT)
            self.optimiser.step()
            losses.append(loss.detach())
        return torch.stack(losses).mean().item()

    def _set_learning_rate(self) -> None:
        if self.config.loss == "one_step":
            return
        done = torch.tensor(torch.pi * (self.epoch - 1) / self.config.epochs)
        share = LAST_RATE + (1 - LAST_RATE) * 0.5 * (1 + torch.cos(done).item())
        for group in self.optimiser.param_groups:
            group["lr"] = share * self.config.learning_rate

    @torch.no_grad()
    def _validate(self) -> float:
        self.model.eval()
        parts = self.validation.split(VALIDATION_BATCH)
        total = sum(self._loss(part, self.horizon).item() * len(part) for part in parts)
        return total / len(self.validation)

    def _loss(self, batch: TensorDictBase, horizon: int) -> Tensor:
        # Members are trained separately: the loss is not that of their mean.
        members = self.model.members if isinstance(self.model, Ensemble) else [self.model]
        if self.config.loss == "one_step":
            losses = [one_step_loss(member, batch) for member in members]
        else:
            losses = [rollout_loss(member, batch, horizon, self.dt) for member in members]
        return torch.stack(losses).mean()


def _copy(state: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.clone() for name, tensor in state.items()}
