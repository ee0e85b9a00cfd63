"""Building, saving and loading models."""

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from buggy_rl.core.config import belongs_to, load_named
from buggy_rl.core.files import load_torch, save_torch
from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.simulators.learned import MODELS
from buggy_rl.simulators.learned.base import DynamicsModel, Ensemble


@dataclass(frozen=True)
class ModelConfig:
    """Kind and size of a model."""

    kind: str = "mlp"
    """A name in `MODELS`: mlp, temporal_cnn, gru, transformer."""
    members: int = 1
    """Models in the ensemble; 1 is a single model."""
    options: dict[str, Any] = field(default_factory=dict, metadata=belongs_to("kind"))
    """Arguments of the model's class, e.g. rows (of history) or hidden."""


def make_model(config: ModelConfig) -> DynamicsModel:
    """Builds an untrained model.

    Raises:
        ValueError: The kind or an option is unknown.
    """
    if config.kind not in MODELS:
        raise ValueError(f"no model {config.kind!r}; available: {', '.join(sorted(MODELS))}")
    model_class = load_named(MODELS[config.kind])
    try:
        members = [model_class(**config.options) for _ in range(config.members)]
    except TypeError as error:
        raise ValueError(f"model {config.kind!r}: {error}") from None
    return members[0] if config.members == 1 else Ensemble(members)


def save_model(model: DynamicsModel, config: ModelConfig, file: Path, about: dict) -> None:
    """Writes weights, normalisation, envelope and `about`, the metadata of the training."""
    content: dict[str, Any] = {
        "model": asdict(config),
        "weights": model.state_dict(),
        "about": about,
    }
    if model.command != ONE_WAY:
        content["command"] = model.command.plain
    save_torch(file, content)


def load_about(file: Path | str) -> tuple[dict, dict]:
    """Reads the config and the training metadata of a model without building it."""
    content = _read(file)
    return content["model"], content["about"]


def load_model(file: Path | str) -> tuple[DynamicsModel, dict]:
    """Reads a model, frozen and in evaluation mode, and its training metadata.

    Raises:
        ValueError: The file is not a model of this version.
    """
    content = _read(file)
    model = make_model(ModelConfig(**content["model"]))
    model.command = LongitudinalCommand.of(content.get("command", ONE_WAY))
    try:
        model.load_state_dict(content["weights"])
    except RuntimeError as error:
        raise ValueError(f"{file} is a model of another version; train it again") from error
    return model.eval().requires_grad_(False), content["about"]


def _read(file: Path | str) -> dict:
    if not Path(file).is_file():
        raise ValueError(f"there is no model file {file}; train one with scripts/train_models.py")
    content = load_torch(file)
    if not isinstance(content, dict) or not {"model", "weights", "about"} <= set(content):
        raise ValueError(f"{file} was not written by scripts/train_models.py")
    return content
