"""How much a joint search rolls out, and how much less for a slow simulator."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from buggy_rl.estimation.hypothesis import TRIAL_SIZES


@dataclass(frozen=True)
class Budget:
    """Sizes of a joint search; the defaults are those of a simulator that is fast enough."""

    fitted: Mapping[int, int] = field(default_factory=lambda: {1: 6, 2: 6, 3: 4})
    """Effects of a set -> sets of that size that are fitted at first."""
    around: int = 3
    """Sets of each size that are fitted about the leading one."""
    rounds: int = 5
    """Times that the leading set is looked at anew, at most."""
    iterations: int = 10
    """Gauss-Newton iterations of a fit."""
    refitted: int = 12
    """Hypotheses that are fitted on at the end: those of the first round stopped early."""
    sizes: tuple[float, ...] = TRIAL_SIZES
    """[prior scales] at which each effect is rolled out before anything is fitted."""
    share: float = 1.0
    """Share of the segments."""
    anew: bool = True
    """Whether what is held out is rolled out anew; predicted to first order otherwise."""
    longer: bool = True
    """Whether errors are told at horizons beyond the segments too."""
    experiments: bool = True
    """Whether it is looked for what to drive next."""
    terms: int = 24
    """Segments on which equations without a name are screened; 0 where none is looked for."""

    @property
    def sets(self) -> int:
        """Sets of effects that are fitted at first."""
        return sum(self.fitted.values())

    def segments(self, count: int) -> int:
        """Number of segments that are used, of `count`."""
        return min(count, max(LEAST_SEGMENTS, round(self.share * count)))

    def loss(self, count: int) -> str:
        """What is lost by it, in one line, of `count` segments; empty for the full budget."""
        full = FULL
        if self == full:
            return ""
        parts = [
            f"{self.segments(count)} of {count} segments",
            f"{self.sets} of {full.sets} sets",
            f"{self.iterations} of {full.iterations} iterations",
            f"{self.rounds} of {full.rounds} rounds",
        ]
        if self.refitted != full.refitted:
            parts.append(f"{self.refitted} of {full.refitted} sets fitted on at the end")
        if not self.anew:
            parts.append("held-out residuals to first order")
        if not self.longer:
            parts.append("no errors beyond 1 s")
        if not self.terms:
            parts.append("no equations without a name")
        if self.sizes != full.sizes:
            parts.append(f"{len(self.sizes)} of {len(full.sizes)} trial sizes")
        surely = "pairs are found less surely" if self.sets > 6 else "pairs are hardly found"
        return (
            f"{', '.join(parts)}: {surely}, the true effect may be among those that were not "
            "fitted, intervals are wider; minutes=0 leaves nothing out"
        )


LEAST_SEGMENTS = 16  # two blocks of 8 s: with fewer there is nothing to hold out; chosen
FULL = Budget()
FEWER = (
    {},
    *({"rounds": r, "iterations": i} for r, i in ((2, 4), (1, 4), (1, 3), (1, 2))),
    {"rounds": 1, "iterations": 1, "refitted": 0, "longer": False, "terms": 0},
    {"rounds": 0, "iterations": 1, "refitted": 0, "longer": False, "anew": False, "terms": 0},
)
"""Fewer rollouts, one after the other: for a simulator whose step takes long whatever the batch."""
THINNER = (
    {},
    {"fitted": {1: 5, 2: 5, 3: 3}, "share": 0.75, "terms": 12},
    {"fitted": {1: 5, 2: 4, 3: 2}, "share": 0.5, "around": 2, "terms": 6},
    {"fitted": {1: 4, 2: 3, 3: 1}, "share": 0.35, "around": 2, "terms": 0},
    {"fitted": {1: 4, 2: 2}, "share": 0.25, "around": 1, "sizes": (0.7,), "terms": 0},
    {"fitted": {1: 3, 2: 1}, "share": 0.0, "around": 1, "sizes": (0.7,), "terms": 0},
)
"""Rollouts of fewer environments: for a simulator whose step takes as long as it has of them."""


def smaller() -> Iterator[Budget]:
    """Budgets from the full one to the least: what loses less comes first, segments last."""
    for loss in range(len(FEWER) + len(THINNER) - 1):
        for thin in range(len(THINNER)):
            if 0 <= loss - thin < len(FEWER):
                changed: dict[str, Any] = {**THINNER[thin], **FEWER[loss - thin]}
                yield replace(FULL, **changed)
