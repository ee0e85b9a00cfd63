"""Fractional delays: how far back, and between which rows."""

import math

from torch import Tensor

from buggy_rl.effects.base import EffectParameter

LONGEST = 0.3  # [s] dead time that is remembered
SHORTEST_LAG = 1e-6  # [s] stands for none, where the formula divides by zero


def dead_time(meaning: str) -> tuple[EffectParameter, ...]:
    """The parameter of a dead time."""
    return (EffectParameter("dead_time", 0.0, 0.0, LONGEST, "s", meaning, 0.06, 0.01),)


def rows_back(longest: Tensor, dt: float) -> int:
    """Rows to remember for dead times [*] s; all that are allowed where they cannot be read."""
    most = math.ceil(LONGEST / dt)
    if longest.device.type == "meta":
        return most
    return min(max(math.ceil(float(longest.max()) / dt - 1e-6), 1), most)


def taps(dead_time: Tensor, dt: float, most: int) -> tuple[Tensor, Tensor]:
    """Whole rows back [*] int64, of `most` at the furthest, and the share [*] of the row before."""
    rows = (dead_time / dt).clamp(0.0, float(most))
    whole = rows.floor().clamp_max(most - 1.0)
    return whole.long(), rows - whole
