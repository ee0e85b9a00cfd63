"""A learned correction of a simulator's error on baseline recordings; it names no cause."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import torch
from torch import Tensor, nn

from buggy_rl.core.files import load_torch
from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect

INPUTS = 8  # vx, vy, yaw_rate, throttle, steering, and the engine's ax, ay, yaw acceleration
FORMAT = "buggy_rl residual acceleration 1"


class ResidualNetwork(nn.Module):
    """a = bound tanh(network(inputs)): an acceleration within the range of the training data.

    Inputs are normalised and clamped to `REACH`, so that beyond the training data the output is
    that at its edge.

    Args:
        width: Of both hidden layers.
    """

    REACH = 3.0  # [-] standard deviations of the training data; chosen

    mean: Tensor
    scale: Tensor
    bound: Tensor

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

    def forward(self, inputs: Tensor) -> Tensor:
        """Acceleration [*, 3] (m/s^2, m/s^2, rad/s^2) at the centre of gravity of inputs [*, 8]."""
        normal = ((inputs - self.mean) / self.scale).clamp(-self.REACH, self.REACH)
        return self.bound * torch.tanh(self.layers(normal))

    def save(self, file: Path | str) -> None:
        """Writes it for `load`."""
        content = {"format": FORMAT, "width": self.width, "weights": self.state_dict()}
        torch.save(content, file)

    @classmethod
    def load(cls, file: Path | str) -> Self:
        """Reads what `save` wrote.

        Raises:
            ValueError: The file is missing or is something else.
        """
        if not Path(file).is_file():
            raise ValueError(
                f"there is no correction {file}: it is written beside repaired.yaml by "
                "scripts/diagnose.py with baseline=; keep both together"
            )
        content = load_torch(file)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise ValueError(f"{file} is no correction written by scripts/diagnose.py")
        network = cls(content["width"])
        network.load_state_dict(content["weights"])
        return network.eval().requires_grad_(False)


class ResidualAcceleration(MotionEffect):
    """A learned correction of a simulator, without a physical meaning.

    Args:
        model: File of a `ResidualNetwork`, or one.
        dimensions, dt, values: As for `MotionEffect`.

    Raises:
        ValueError: The file is missing or is something else.
    """

    name = "residual_acceleration"
    equation = "d(vx, vy, yaw_rate)/dt = strength network(v, command, engine's accelerations)"
    source = "none: a neural network, trained by buggy_rl.estimation.baseline"
    declared = (EffectParameter("strength", 0.0, 0.0, 2.0, "-", "1 is as trained.", 0.5, 0.05),)

    def __init__(self, *, model: Path | str | ResidualNetwork, **rest: Any) -> None:
        self._file = None if isinstance(model, ResidualNetwork) else str(model)
        network = model if isinstance(model, ResidualNetwork) else ResidualNetwork.load(model)
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
