"""Where the form of the repaired simulator is wrong: a velocity that is off in one condition.

What no effect describes has no name, but it has a side: the median of the residual of a velocity,
with its sign, in bins of what was driven.
"""

import itertools
import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from buggy_rl.diagnosis.localisation import features
from buggy_rl.diagnosis.search_result import SearchResult
from buggy_rl.diagnosis.words import CONDITIONS, READINGS
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.segments import CHANNELS

BINS = 5  # of a condition, with equal shares of the instants
MOST = 3  # faults that are reported
SIGNIFICANT = 3.0  # [standard errors] from which a median is not taken for chance
NOTICED = 1.0  # [noise standard deviations] from which it is worth a sentence
BINNED = ("vx", "steering", "throttle", "steering_rate", "lateral_acceleration", "elapsed")
QUARTILES = torch.tensor([0.25, 0.5, 0.75], dtype=torch.float64)


@dataclass(frozen=True)
class FormFault:
    """A velocity that the repaired simulator gets wrong to one side in one condition."""

    channel: str
    condition: str
    low: float
    high: float
    """Bounds of the condition."""
    median: float
    """Simulated minus measured, median over segments of each one's mean [m/s or rad/s]."""

    def line(self) -> str:
        """The fault in words."""
        reading, condition = READINGS[self.channel], CONDITIONS[self.condition]
        words, of = reading.fault or reading.words, condition.unit
        side = "too high" if self.median > 0 else "too low"
        bounds = f"{self.low:.2g} to {self.high:.2g}" + (f" {of}" if of else "")
        return (
            f"{words} {abs(self.median):.2g} {reading.unit} {side} (median) at "
            f"{condition.words} {bounds}"
        )

    def to_dict(self) -> dict[str, Any]:
        """As `diagnosis.json` has it."""
        return asdict(self)


def form_faults(problem: Problem, found: SearchResult) -> list[FormFault]:
    """Of the best description, the largest first; one for each channel at most."""
    best = found.described.fit
    settings = problem.library.settings([(best, best.vector)])
    residual = problem.simulation.residuals(problem.segments, settings)[0]  # (N, K, 6)
    instants = problem.simulation.instants(problem.segments)
    noise = problem.noise.sd[3:].tolist()
    conditions = features(problem.segments, instants)
    result = []
    for index, channel in enumerate(CHANNELS):
        off = residual[..., 3 + index].double()
        faults = [
            (abs(fault.median) / noise[index], fault)
            for name in BINNED
            for fault in _off(off, conditions[name].double(), channel, name, noise[index])
        ]
        result += sorted(faults, key=lambda item: -item[0])[:1]
    return [fault for _, fault in sorted(result, key=lambda item: -item[0])][:MOST]


def _off(off: Tensor, condition: Tensor, channel: str, name: str, noise: float) -> list[FormFault]:
    """Bins of a condition [N, K] in which a residual [N, K] is off to one side."""
    edges = np.unique(np.quantile(condition.numpy(), np.linspace(0, 1, BINS + 1)))
    found = []
    for low, high in itertools.pairwise(edges):
        inside = (condition >= low) & (condition <= high) & off.isfinite()
        count = inside.sum(-1)
        of_segment = torch.where(inside, off, 0.0).sum(-1)[count > 0] / count[count > 0]
        if len(of_segment) < BINS:
            continue
        # Instants of a segment share its start: segments are the independent samples.
        first, median, third = of_segment.quantile(QUARTILES).tolist()
        # 1.253 sd / sqrt(n) is the standard error of a median; the quartiles are 1.349 sd apart.
        error = 1.253 * (third - first) / 1.349 / math.sqrt(len(of_segment))
        if abs(median) > max(SIGNIFICANT * error, NOTICED * noise):
            found.append(FormFault(channel, name, float(low), float(high), median))
    return found
