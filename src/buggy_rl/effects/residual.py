"""A learned correction of a simulator's error; it names no cause."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from buggy_rl.effects.base import EffectParameter
from buggy_rl.effects.motion.base import Motion, MotionEffect
from buggy_rl.effects.residual_models import LAGS, Residual, ResidualProcess, load_residual

PAST = 2 * len(LAGS)  # lagged commands


class ResidualAcceleration(MotionEffect):
    """A learned correction of a simulator, without a physical meaning.

    Args:
        model: File of a model, or one.
        dimensions, dt, values: As for `MotionEffect`.

    Raises:
        ValueError: The file is missing or is something else.
    """

    name = "residual_acceleration"
    equation = "d(vx, vy, yaw_rate)/dt = strength model(v, command, engine's accelerations)"
    source = "none: learned from recordings by buggy_rl.estimation"
    declared = (EffectParameter("strength", 0.0, 0.0, 2.0, "-", "1 is as trained.", 0.5, 0.05),)

    def __init__(self, *, model: Path | str | Residual, **rest: Any) -> None:
        self._file = str(model) if isinstance(model, Path | str) else None
        network = load_residual(model) if isinstance(model, Path | str) else model
        super().__init__(**rest)
        self.network = network
        # The lagged commands, and 1 once they are known.
        self.state_size = PAST + 1 if network.needs_past else 0

    @property
    def options(self) -> dict[str, Any]:
        model = self.network if self._file is None else self._file
        return super().options | {"model": model}

    @property
    def of_each(self) -> bool:
        """Whether each environment has a model of its own: then there can be no more of them."""
        return isinstance(self.network, ResidualProcess) and self.network.of_each

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return (
            "a learned correction of what the simulator gets wrong anyway is in force, at "
            f"{100 * values['strength']:.3g} % of its strength"
        )

    def _change(self, motion: Motion) -> Tensor:
        return self._change_and_state(motion)[0]

    def _change_and_state(self, motion: Motion) -> tuple[Tensor, Tensor | None]:
        inputs, state = residual_inputs(motion), None
        if motion.state is not None:
            known, before = motion.state[..., PAST:] > 0, motion.state[..., :PAST]
            past = lagged_commands(before, motion.action, known, self.dt)
            state = torch.cat([past, torch.ones_like(motion.state[..., PAST:])], -1)
            inputs = torch.cat([inputs, past], -1)
        acceleration = self.network(inputs.float()).to(motion.after.dtype)
        return self._value("strength").unsqueeze(-1) * acceleration * self.dt, state


def residual_inputs(motion: Motion) -> Tensor:
    """Inputs of a model [n, 8] that do not need the past."""
    own = torch.stack(motion.acceleration, -1)
    return torch.cat([motion.before, motion.action, own], -1)


def lagged_commands(before: Tensor, action: Tensor, known: Tensor, dt: float) -> Tensor:
    """Commands [n, 4] through each of `LAGS`, after a step under `action` [n, 2].

    Args:
        before: [n, 4] before the step.
        action: Throttle and steering.
        known: [n, 1] whether `before` is known; what is not has been as it is now.
        dt: Step [s].
    """
    now = torch.cat([action] * len(LAGS), -1)
    late = torch.where(known, before, now)
    share = [dt / (lag + dt) for lag in LAGS for _ in range(2)]
    return late + (now - late) * torch.as_tensor(share, dtype=now.dtype, device=now.device)
