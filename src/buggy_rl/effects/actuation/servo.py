"""Limits of the steering servo: its speed, and play in the linkage behind it."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor

from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.base import EffectParameter

NO_LIMIT = 1e6  # [1/s] neutral rate: the whole range of 2 in 2 us, faster than any command


class ServoEffect(RememberingCommand):
    """Road wheels at r_k = f(r_{k-1}, u_k) in command units, instead of where the simulator's are.

    The simulator's own servo follows its command with a first-order lag,
    s_k = s_{k-1} + a (u_k - s_{k-1}), a = 1 - exp(-dt / lag). To have it at r_k the engine gets

    u'_k = r_{k-1} + (r_k - r_{k-1}) / a.

    `measured_steering_lag` finds the lag of a simulator. Without one, a = 1 and u'_k = r_k.
    """

    channel = 1
    lasting = True
    option_names = ("lag",)
    lag: float = 0.0
    """Time constant of the simulator's servo [s]."""

    @property
    def follows(self) -> float:
        """a, the share of its error that the simulator's servo corrects in a period."""
        return -math.expm1(-self.dt / self.lag) if self.lag > 0 else 1.0

    def _command_between(self, before: Tensor, after: Tensor) -> Tensor:
        """Command [n] that moves the simulator's servo from r_{k-1} to r_k."""
        return before + (after - before) / self.follows


class SteeringRateLimit(ServoEffect):
    """Rate limit: r moves by m = min(max(a (u - r), -rate dt), rate dt) in a period.

    Without a lag the engine follows at once; it gets the mean over the period then,
    r + m - m |m| / (2 rate dt).
    """

    name = "steering_rate_limit"
    look_at = (
        "Check the servo: its rated speed, its supply voltage, and how freely the linkage moves."
    )
    equation = "|du'/dt| <= rate"
    source = "Stein 2003, Respect the Unstable, IEEE Control Systems Magazine 23(4) (rate limit)"
    declared = (
        EffectParameter(
            "rate",
            NO_LIMIT,
            0.2,
            NO_LIMIT,
            "1/s",
            "Fastest change of the steering command, of which the whole range is 2.",
            size=7.0,
            probe=6.0 - NO_LIMIT,
            reciprocal=True,
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return f"the steering needs {2000 / values['rate']:.3g} ms from full right to full left"

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        start = state.squeeze(-1)
        reach = (self._value("rate") * self.dt).clamp_min(1e-9)
        change = self.follows * (command - start)
        moved = torch.minimum(torch.maximum(change, -reach), reach)
        if self.lag > 0:
            acting = torch.where(
                moved == change, command, self._command_between(start, start + moved)
            )
        else:
            # It moves for the share |moved| / reach of the period, on average at half the change.
            acting = start + moved - 0.5 * moved * moved.abs() / reach
        return acting, (start + moved).unsqueeze(-1)


class SteeringBacklash(ServoEffect):
    """Play: the linkage moves only after the servo has gone through the play.

    r_k = min(max(r_{k-1}, s_k - w / 2), s_k + w / 2), w the full width from stop to stop.
    """

    name = "steering_backlash"
    look_at = (
        "Hold the servo and move the front wheels by hand: play in horn, linkage, servo saver."
    )
    equation = "|servo - steering'| <= width / 2, and steering' rests while it can"
    source = "Khalil 2002, Nonlinear Systems, 3rd ed., sec. 1.2.7 (backlash)"
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

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        half = 0.5 * self._value("width").clamp_min(0.0)
        before, linkage = state.unbind(-1)
        servo = before + self.follows * (command - before)
        moved = torch.minimum(torch.maximum(linkage, servo - half), servo + half)
        acting = torch.where(half > 0, self._command_between(linkage, moved), command)
        return acting, torch.stack([servo, moved], -1)
