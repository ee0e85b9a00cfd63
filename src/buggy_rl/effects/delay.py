"""Delays of a whole or fractional number of control periods, and first-order lags."""

import math

import torch
from torch import Tensor

from buggy_rl.effects.base import Effect, EffectParameter

LONGEST = 0.3  # [s] longest dead time that the memory of past rows covers; DART's is 0.14 s
SHORTEST_LAG = 1e-6  # [s] stands for no lag, where the formula divides by the time constant

DEAD_TIME_SOURCE = "Astrom & Murray 2008, Feedback Systems, table 8.1 (time delay)"
LAG_SOURCE = "Astrom & Murray 2008, Feedback Systems, table 8.1 (first-order system)"


def dead_time(size: float, usual: tuple[float, float] | None = None) -> tuple[EffectParameter]:
    """The parameter of a dead time, of a prior scale and usual values [s]."""
    return (
        EffectParameter("dead_time", 0.0, 0.0, LONGEST, "s", "Delay.", size, 0.01, usual=usual),
    )


def time_constant(size: float, usual: tuple[float, float] | None = None) -> tuple[EffectParameter]:
    """The parameter of a first-order lag, of a prior scale and usual values [s]."""
    meaning = "Time to 63 % of a step."
    return (EffectParameter("time_constant", 0.0, 0.0, 1.0, "s", meaning, size, 0.01, usual=usual),)


class DeadTimeEffect(Effect):
    """A dead time of whole + share periods, by a memory of past rows."""

    source = DEAD_TIME_SOURCE

    def _values_changed(self) -> None:
        self._rows_back = rows_back(self.values["dead_time"], self.dt)
        whole, share = taps(self._value("dead_time"), self.dt, self._rows_back)
        self._store(whole=whole, share=share)


def rows_back(longest: Tensor, dt: float) -> int:
    """Rows to remember for dead times [*] s; all that are allowed on the meta device."""
    most = math.ceil(LONGEST / dt)
    if longest.device.type == "meta":
        return most
    return min(max(math.ceil(float(longest.max()) / dt - 1e-6), 1), most)


def taps(dead_time: Tensor, dt: float, most: int) -> tuple[Tensor, Tensor]:
    """Whole rows back [*] int64, at most `most`, and the share [*] of the row before that."""
    rows = (dead_time / dt).clamp(0.0, float(most))
    whole = rows.floor().clamp_max(most - 1.0)
    return whole.long(), rows - whole


def lag_decay(time_constant: Tensor, dt: float) -> tuple[Tensor, Tensor]:
    """What a first-order lag still has to go: at the end of a period, and on average over it.

    e = exp(-dt / T) and (1 - e) T / dt, each [*], of time constants T [*] s.
    """
    lag = time_constant.clamp_min(SHORTEST_LAG)
    passed = -torch.expm1(-dt / lag)
    return 1 - passed, passed * lag / dt
