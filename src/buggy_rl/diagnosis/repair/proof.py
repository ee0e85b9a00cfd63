"""Errors of rollouts on what was held out: as given, repaired, re-tuned, learned."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

SAID = 1.0  # [s] horizon of the errors that are said
OTHERS = {"retuned": "re-tuned alone", "black_box": "with a learned residual"}
BETTER = 0.8  # [-] of the repair's error, below which a learned residual is worth a word; chosen


@dataclass(frozen=True)
class Proof:
    """Rollouts on what was held out, by horizon in seconds; position errors as mean squares."""

    before: dict[float, float]
    after: dict[float, float]
    retuned: dict[float, float]
    noise_floor: dict[float, float]
    black_box: dict[float, float]
    misfit_before: float
    """Root mean square of the standardised residuals of 1 s rollouts."""
    misfit_after: float
    held_out: bool
    median: dict[str, dict[float, float]] = field(default_factory=dict)
    """before, after, retuned, black_box -> horizon -> median distance [m]; robust to spins."""

    def better_than(self, other: "Proof") -> bool:
        """Whether both its misfit and its median distance after the longest rollouts are smaller.

        Where most segments are far beyond the noise, the cap on each makes the misfit insensitive.
        """
        own, its = (max(p.median.get("after", {}).items(), default=(0, 0.0)) for p in (self, other))
        return self.misfit_after < other.misfit_after and own[1] <= its[1]

    @property
    def prefers_retuning(self) -> bool:
        """Whether parameters fitted alone predict what was held out better than what is named."""
        tuned, after = (self.median.get(name, {}).get(SAID) for name in ("retuned", "after"))
        if tuned is None or after is None:
            return False
        return tuned < after and self.retuned[SAID] < self.after[SAID]

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`, under `fit`."""
        squares = ("before", "after", "retuned", "noise_floor", "black_box")
        return {
            "metric": "1 s open-loop",
            "before": self.misfit_before,
            "after": self.misfit_after,
            "noise_floor": 1.0,
            "held_out": self.held_out,
            "position_mse_before": self.before.get(SAID),
            "position_mse_after": self.after.get(SAID),
            "position_mse": {name: _by_horizon(getattr(self, name)) for name in squares},
            "position_median": {name: _by_horizon(of) for name, of in self.median.items()},
        }

    def lines(self) -> list[str]:
        """The error before and after the repair, and what simpler repairs come to."""
        if SAID not in self.before or SAID not in self.after:
            return []
        data = "held-out data" if self.held_out else "the data that were fitted"
        root = _millimetres(math.sqrt(self.before[SAID]), math.sqrt(self.after[SAID]))
        words = f"root mean square {root}"
        if {"before", "after"} <= set(self.median):
            median = _millimetres(self.median["before"][SAID], self.median["after"][SAID])
            words = f"median {median}; {words}"
        return [f"Position error of 1 s rollouts on {data}: {words}.", *self._others()]

    def _others(self) -> list[str]:
        """Median errors of what anyone would try first."""
        of: Mapping[str, dict[float, float]] = self.median
        parts = [
            f"{1000 * of[name][SAID]:.0f} mm {words}"
            for name, words in OTHERS.items()
            if math.isfinite(of.get(name, {}).get(SAID, math.nan))
        ]
        if not parts:
            return []
        after, learned = (of.get(name, {}).get(SAID, math.nan) for name in ("after", "black_box"))
        more = ", which is in no file: it shows how much is still to be named"
        return [
            f"In comparison, median: {', '.join(parts)}{more if learned < BETTER * after else ''}."
        ]


def _by_horizon(values: Mapping[float, float]) -> dict[str, float]:
    return {f"{horizon:g} s": value for horizon, value in values.items()}


def _millimetres(before: float, after: float) -> str:
    return f"{1000 * before:.0f} mm before, {1000 * after:.0f} mm after"
