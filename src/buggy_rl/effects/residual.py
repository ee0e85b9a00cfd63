"""A learned correction of a simulator's error on baseline recordings; it names no cause."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn

from buggy_rl.core.files import load_torch
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect

INPUTS = 8  # vx, vy, yaw_rate, throttle, steering, and the engine's ax, ay, yaw acceleration
FORMAT = "buggy_rl residual acceleration 1"
SEVERAL = "buggy_rl residual accelerations 1"


class ResidualNetwork(nn.Module):
    """a = bound tanh(network(x)) exp(-beyond^2 / 2): silent outside its training data.

    x: inputs in standard deviations of the training data, clamped to `REACH`; beyond: how far they
    are, in those, outside the range of the training data.

    Args:
        width: Of both hidden layers.
    """

    REACH = 3.0  # [-] standard deviations of the training data; chosen

    mean: Tensor
    scale: Tensor
    bound: Tensor
    low: Tensor
    high: Tensor

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.width = width
        self.layers = nn.Sequential(
            nn.Linear(INPUTS, width),
            nn.Tanh(),
            nn.Linear(width, width),
            nn.Tanh(),
            nn.Linear(width, 3),
        )
        self.register_buffer("mean", torch.zeros(INPUTS))
        self.register_buffer("scale", torch.ones(INPUTS))
        self.register_buffer("bound", torch.ones(3))
        # Range of the training data; without end in files that do not have it.
        self.register_buffer("low", torch.full((INPUTS,), -torch.inf))
        self.register_buffer("high", torch.full((INPUTS,), torch.inf))

    def forward(self, inputs: Tensor) -> Tensor:
        """Acceleration [*, 3] (m/s^2, m/s^2, rad/s^2) at the centre of gravity of inputs [*, 8]."""
        normal = ((inputs - self.mean) / self.scale).clamp(-self.REACH, self.REACH)
        outside = inputs - torch.minimum(torch.maximum(inputs, self.low), self.high)
        beyond = (outside / self.scale).square().sum(-1, keepdim=True)
        return self.bound * torch.tanh(self.layers(normal)) * torch.exp(-0.5 * beyond)

    @property
    def content(self) -> dict[str, Any]:
        """Content of its file."""
        return {"format": FORMAT, "width": self.width, "weights": self.state_dict()}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """The network of a file's content."""
        network = cls(content["width"])
        network.load_state_dict({**network.state_dict(), **content["weights"]})
        return network.eval().requires_grad_(False)

    def save(self, file: Path | str) -> None:
        """Writes it for `load_residual`."""
        torch.save(self.content, file)


class ResidualNetworks(nn.Module):
    """Networks one upon the other: each sees the accelerations with those before it in place.

    Args:
        parts: Strength [-] of each network, and the network.
    """

    def __init__(self, parts: Sequence[tuple[float, ResidualNetwork]]) -> None:
        super().__init__()
        self.strengths = [strength for strength, _ in parts]
        self.networks = nn.ModuleList(network for _, network in parts)

    def forward(self, inputs: Tensor) -> Tensor:
        """Acceleration [*, 3] of all of them of inputs [*, 8]."""
        seen, own = inputs.split([INPUTS - 3, 3], -1)
        total = torch.zeros_like(own)
        for strength, network in zip(self.strengths, self.networks, strict=True):
            total = total + strength * network(torch.cat([seen, own + total], -1))
        return total

    def save(self, file: Path | str) -> None:
        """Writes it for `load_residual`."""
        parts = [
            (strength, network.content)
            for strength, network in zip(self.strengths, self.networks, strict=True)
        ]
        torch.save({"format": SEVERAL, "parts": parts}, file)


Residual = ResidualNetwork | ResidualNetworks


def load_residual(file: Path | str) -> Residual:
    """Reads what a network, or several, have written.

    Raises:
        ValueError: The file is missing or is something else.
    """
    if not Path(file).is_file():
        raise ValueError(
            f"there is no correction {file}: it is written beside repaired.yaml by "
            "scripts/diagnose.py; keep both together"
        )
    content = load_torch(file)
    kind = content.get("format") if isinstance(content, dict) else None
    if kind == SEVERAL:
        parts = [(strength, ResidualNetwork.of(part)) for strength, part in content["parts"]]
        return ResidualNetworks(parts).eval()
    if kind != FORMAT:
        raise ValueError(f"{file} is no correction written by scripts/diagnose.py")
    return ResidualNetwork.of(content)


class ResidualAcceleration(MotionEffect):
    """A learned correction of a simulator, without a physical meaning.

    Args:
        model: File of a network or of several, or one.
        dimensions, dt, values: As for `MotionEffect`.

    Raises:
        ValueError: The file is missing or is something else.
    """

    name = "residual_acceleration"
    equation = "d(vx, vy, yaw_rate)/dt = strength network(v, command, engine's accelerations)"
    source = "none: a neural network, trained by buggy_rl.estimation.baseline"
    declared = (EffectParameter("strength", 0.0, 0.0, 2.0, "-", "1 is as trained.", 0.5, 0.05),)

    def __init__(self, *, model: Path | str | Residual, **rest: Any) -> None:
        self._file = str(model) if isinstance(model, Path | str) else None
        network = load_residual(model) if isinstance(model, Path | str) else model
        super().__init__(**rest)
        self.network = network

    @property
    def options(self) -> dict[str, Any]:
        model = self.network if self._file is None else self._file
        return super().options | {"model": model}

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            "a learned correction of what the simulator gets wrong anyway is in force, at "
            f"{100 * values['strength']:.3g} % of its strength"
        )

    def _change(self, motion: Motion) -> Tensor:
        acceleration = self.network(residual_inputs(motion))
        return self._value("strength").unsqueeze(-1) * acceleration * self.dt


def residual_inputs(motion: Motion) -> Tensor:
    """Inputs of the network [n, 8]."""
    own = torch.stack(motion.acceleration, -1)
    return torch.cat([motion.before, motion.action, own], -1)
