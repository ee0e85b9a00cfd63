"""What limits the steering behind its servo: how fast it moves, and play in the linkage."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.base import EffectParameter

NO_LIMIT = 1e6  # [1/s] so fast that no command shows it


class ServoEffect(RememberingCommand):
    """Where a servo takes the wheels, r_k = f(r_{k-1}, u_k), instead of where it would.

    The simulator's own servo follows its command late, s_k = s_{k-1} + a (u_k - s_{k-1}) with
    a = 1 - exp(-dt / lag). To have it at r_k the engine is told

    u'_k = r_{k-1} + (r_k - r_{k-1}) / a.

    `measured_steering_lag` finds the lag of a simulator. Without one, a = 1 and u'_k = r_k.

    Args:
        lag: Time constant of the simulator's servo [s].
        dt, values: As for the other effects.
    """

    channel = 1

    def __init__(self, *, lag: float = 0.0, **rest: Any) -> None:
        self.lag = float(lag)
        super().__init__(**rest)

    @property
    def options(self) -> dict[str, Any]:
        return super().options | ({"lag": self.lag} if self.lag else {})

    @property
    def follows(self) -> float:
        """a: share of the way to its command that the simulator's servo goes in a period."""
        return -math.expm1(-self.dt / self.lag) if self.lag > 0 else 1.0

    def _told(self, before: Tensor, after: Tensor) -> Tensor:
        """Command [n] that takes the simulator's servo from r_{k-1} to r_k."""
        return before + (after - before) / self.follows


class SteeringRateLimit(ServoEffect):
    """The wheels move by at most the rate: m = min(max(a (u - r), -rate dt), rate dt).

    Without a lag the engine follows at once; it gets the mean over the period then,
    r + m - m |m| / (2 rate dt).
    """

    lasting = True
    name = "steering_rate_limit"
    equation = "|du'/dt| <= rate"
    declared = (
        EffectParameter(
            "rate",
            NO_LIMIT,
            0.2,
            NO_LIMIT,
            "1/s",
            "Fastest change of the steering command, of which the whole range is 2.",
            size=6.0,
            probe=6.0 - NO_LIMIT,
            reciprocal=True,
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the steering needs {2000 / values['rate']:.3g} ms from full right to full left"

    def _moved(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        start = state.squeeze(-1)
        reach = (self._here("rate") * self.dt).clamp_min(1e-9)
        way = self.follows * (command - start)
        moved = torch.minimum(torch.maximum(way, -reach), reach)
        if self.lag > 0:
            told = torch.where(moved == way, command, self._told(start, start + moved))
        else:
            # Of the period the share |moved| / reach is spent moving, at half the way in the mean.
            told = start + moved - 0.5 * moved * moved.abs() / reach
        return told, (start + moved).unsqueeze(-1)


class SteeringBacklash(ServoEffect):
    """Play: the linkage is only moved when the servo has gone through it.

    r_k = min(max(r_{k-1}, s_k - w / 2), s_k + w / 2), w the full width from stop to stop.
    """

    name = "steering_backlash"
    lasting = True
    equation = "|servo - steering'| <= width / 2, and steering' rests while it can"
    declared = (
        EffectParameter(
            "width", 0.0, 0.0, 1.0, "-", "Play from stop to stop, of a range of 2.", 0.1, 0.02
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        share = 50 * values["width"]
        return f"the steering has {share:.3g} % of its range as play when it turns back"

    @property
    def size(self) -> int:
        return 2  # servo, linkage

    def _moved(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        half = 0.5 * self._here("width").clamp_min(0.0)
        before, linkage = state.unbind(-1)
        servo = before + self.follows * (command - before)
        moved = torch.minimum(torch.maximum(linkage, servo - half), servo + half)
        told = torch.where(half > 0, self._told(linkage, moved), command)
        return told, torch.stack([servo, moved], -1)
