"""Models of a residual acceleration, and their files; none of them names a cause."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn

from buggy_rl.core.files import load_torch

MOTION = 8  # vx, vy, yaw_rate, throttle, steering, and the engine's ax, ay, yaw acceleration
OWN = slice(5, MOTION)  # of these the engine's accelerations
LAGS = (0.1, 0.4)  # [s] first-order lags through which both commands are seen as well; chosen
INPUTS = MOTION + 2 * len(LAGS)
REACH = 3.0  # [-] standard deviations of the training data to which inputs are clamped; chosen
FORMATS = {
    "network": "buggy_rl residual acceleration 1",
    "several": "buggy_rl residual accelerations 1",
    "process": "buggy_rl residual process 1",
}


def silence(inputs: Tensor, low: Tensor, high: Tensor, scale: Tensor) -> Tensor:
    """exp(-beyond^2 / 2) [*, 1], beyond: how far inputs [*, I] are outside a range, in scales."""
    outside = inputs - torch.minimum(torch.maximum(inputs, low), high)
    return torch.exp(-0.5 * (outside / scale).square().sum(-1, keepdim=True))


class ResidualNetwork(nn.Module):
    """a = bound tanh(network(x)) exp(-beyond^2 / 2): silent outside its training data.

    x: inputs in standard deviations of the training data, clamped to `REACH`; beyond: how far they
    are, in those, outside the range of the training data.

    Args:
        width: Of both hidden layers.
    """

    needs_past = False
    mean: Tensor
    scale: Tensor
    bound: Tensor
    low: Tensor
    high: Tensor

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.width = width
        self.layers = nn.Sequential(
            nn.Linear(MOTION, width),
            nn.Tanh(),
            nn.Linear(width, width),
            nn.Tanh(),
            nn.Linear(width, 3),
        )
        self.register_buffer("mean", torch.zeros(MOTION))
        self.register_buffer("scale", torch.ones(MOTION))
        self.register_buffer("bound", torch.ones(3))
        # Range of the training data; without end in files that do not have it.
        self.register_buffer("low", torch.full((MOTION,), -torch.inf))
        self.register_buffer("high", torch.full((MOTION,), torch.inf))

    def forward(self, inputs: Tensor) -> Tensor:
        """Acceleration [*, 3] (m/s^2, m/s^2, rad/s^2) at the centre of gravity of inputs [*, 8].

        What inputs have beyond those 8 is not looked at.
        """
        inputs = inputs[..., :MOTION]
        normal = ((inputs - self.mean) / self.scale).clamp(-REACH, REACH)
        share = silence(inputs, self.low, self.high, self.scale)
        return self.bound * torch.tanh(self.layers(normal)) * share

    @property
    def content(self) -> dict[str, Any]:
        """Content of its file."""
        return {"format": FORMATS["network"], "width": self.width, "weights": self.state_dict()}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """The network of a file's content."""
        network = cls(content["width"])
        network.load_state_dict({**network.state_dict(), **content["weights"]})
        return network.eval().requires_grad_(False)

    def save(self, file: Path | str) -> None:
        """Writes it for `load_residual`."""
        torch.save(self.content, file)


class ResidualProcess(nn.Module):
    """a = bound tanh(w^T phi(x)) exp(-beyond^2 / 2): a Gaussian process by random features.

    phi: cosines of random projections, whose kernel is exp(-|x - x'|^2 / (2 length^2)) (Rahimi &
    Recht 2007, Random Features for Large-Scale Kernel Machines, algorithm 1), x itself and 1. x and
    beyond are as of a `ResidualNetwork`, commands that were given earlier included. It is linear in
    w but for its bound, so w can be fitted to rollouts. Every buffer but the projections may have
    one value for each row of a batch.

    Args:
        count: Cosines.
        seed: Of the projections.
    """

    needs_past = True
    LENGTH = 3.0  # [-] of the kernel, in standard deviations of the inputs; chosen
    LINEAR = 0.5  # [-] prior scale of what is linear, beside 1 of the cosines; chosen
    projection: Tensor
    phase: Tensor
    mean: Tensor
    scale: Tensor
    low: Tensor
    high: Tensor
    bound: Tensor
    weights: Tensor

    def __init__(self, count: int = 48, seed: int = 0) -> None:
        super().__init__()
        self.count = count
        random = torch.Generator().manual_seed(seed)
        projection = torch.randn(INPUTS, count, generator=random) / self.LENGTH
        self.register_buffer("projection", projection)
        self.register_buffer("phase", 2 * math.pi * torch.rand(count, generator=random))
        self.register_buffer("mean", torch.zeros(INPUTS))
        self.register_buffer("scale", torch.ones(INPUTS))
        self.register_buffer("low", torch.full((MOTION,), -torch.inf))
        self.register_buffer("high", torch.full((MOTION,), torch.inf))
        self.register_buffer("bound", torch.ones(3))
        self.register_buffer("weights", torch.zeros(self.size, 3))

    @property
    def size(self) -> int:
        """Number of features (F)."""
        return self.count + INPUTS + 1

    @property
    def of_each(self) -> bool:
        """Whether each row of a batch has weights of its own."""
        return self.weights.dim() > 2

    def features(self, inputs: Tensor) -> Tensor:
        """Features [*, F] of inputs [*, 12]."""
        normal = ((inputs - self.mean) / self.scale).clamp(-REACH, REACH)
        cosines = math.sqrt(2 / self.count) * torch.cos(normal @ self.projection + self.phase)
        return torch.cat([cosines, self.LINEAR * normal, torch.ones_like(normal[..., :1])], -1)

    def forward(self, inputs: Tensor) -> Tensor:
        """Acceleration [*, 3] (m/s^2, rad/s^2) at the centre of gravity of inputs [*, 12]."""
        return self.slope(inputs, derivative=False)[1]

    def slope(self, inputs: Tensor, derivative: bool = True) -> tuple[Tensor, Tensor]:
        """Features [*, F]; and the acceleration [*, 3], or its derivative by w^T phi."""
        features = self.features(inputs)
        raw = (features.unsqueeze(-2) @ self.weights).squeeze(-2)
        motion = inputs[..., :MOTION]
        share = silence(motion, self.low, self.high, self.scale[..., :MOTION])
        bent = 1 - torch.tanh(raw).square() if derivative else torch.tanh(raw)
        return features, self.bound * bent * share

    @property
    def content(self) -> dict[str, Any]:
        """Content of its file."""
        return {"format": FORMATS["process"], "count": self.count, "weights": self.state_dict()}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """The process of a file's content."""
        process = cls(content["count"])
        process.load_state_dict(content["weights"])
        return process.eval()

    def save(self, file: Path | str) -> None:
        """Writes it for `load_residual`."""
        torch.save(self.content, file)


class ResidualSum(nn.Module):
    """Models one upon the other: each sees the accelerations with those before it in place.

    Args:
        parts: Strength [-] of each model, and the model.
    """

    def __init__(self, parts: Sequence[tuple[float, "ResidualNetwork | ResidualProcess"]]) -> None:
        super().__init__()
        self.strengths = [strength for strength, _ in parts]
        self.models = nn.ModuleList(model for _, model in parts)
        self.needs_past = any(model.needs_past for _, model in parts)

    def forward(self, inputs: Tensor) -> Tensor:
        """Acceleration [*, 3] of all of them of inputs [*, 12], or [*, 8] without a past."""
        before, own, past = inputs[..., : OWN.start], inputs[..., OWN], inputs[..., OWN.stop :]
        total = torch.zeros_like(own)
        for strength, model in zip(self.strengths, self.models, strict=True):
            total = total + strength * model(torch.cat([before, own + total, past], -1))
        return total

    def save(self, file: Path | str) -> None:
        """Writes it for `load_residual`."""
        models = zip(self.strengths, self.models, strict=True)
        parts = [(strength, model.content) for strength, model in models]
        torch.save({"format": FORMATS["several"], "parts": parts}, file)


Residual = ResidualNetwork | ResidualProcess | ResidualSum


def load_residual(file: Path | str) -> Residual:
    """Reads what a model has written.

    Raises:
        ValueError: The file is missing or is something else.
    """
    if not Path(file).is_file():
        raise ValueError(
            f"there is no correction {file}: it is written beside repaired.yaml by "
            "scripts/diagnose.py; keep both together"
        )
    content = load_torch(file)
    if not isinstance(content, dict) or content.get("format") not in FORMATS.values():
        raise ValueError(f"{file} is no correction written by scripts/diagnose.py")
    if content["format"] == FORMATS["several"]:
        return ResidualSum([(strength, _single(part)) for strength, part in content["parts"]])
    return _single(content)


def _single(content: Mapping[str, Any]) -> ResidualNetwork | ResidualProcess:
    kinds = {FORMATS["network"]: ResidualNetwork, FORMATS["process"]: ResidualProcess}
    return kinds[content["format"]].of(content)
