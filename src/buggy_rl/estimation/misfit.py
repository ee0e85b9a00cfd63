"""Misfit: mean standardised residual, 1 for noise alone; and what is usual on a baseline."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

NOTHING = 0.05  # [noise sd] excess misfit below which nothing is left to explain
CAP = 100.0  # [noise variances] as which a segment counts at most: spins end far apart


def misfit(square: Tensor, given: Tensor | None = None) -> float:
    """Mean of |W e| / sqrt(D) of segments, each counted as sqrt(`CAP`) at most.

    A segment in which a car spins weighs no more than the cap, but counts as closed by as much as
    it is: with `given`, m = mean(1 + w (r - 1)), w = min(1, (sqrt(CAP) - 1) / (r_given - 1)).

    Args:
        square: [N] |W e|^2 / D.
        given: [N] likewise of the simulator as given, where it is compared with that.
    """
    root, most = square.sqrt(), CAP**0.5
    if given is None:
        # Where most segments are beyond the cap, the median is what is typical.
        return max(float(root.clamp_max(most).mean()), float(root.median()))
    weight = ((most - 1) / (given.sqrt() - 1).clamp_min(1e-9)).clamp_max(1.0)
    return float((1 + weight * (root - 1)).clamp_max(most).mean())


@dataclass(frozen=True)
class BaselineMisfit:
    """Excess misfit of a simulator on recordings on which it counts as right."""

    mean: float = 0.0
    """Below 0 where the sensor is less noisy than it is taken for."""
    error: float = 0.0
    """Standard error of the mean over as many blocks as the new recordings have."""

    @property
    def most(self) -> float:
        """Excess misfit within which new recordings are as right as those."""
        return max(NOTHING, self.mean + 3 * self.error)

    def beyond(self, excess: float) -> float:
        """Expected excess misfit over this, where there cannot be less than none.

        E[max(0, x)], x ~ N(excess - mean, error^2): over Phi(over / error) + error phi(over /
        error), over = excess - mean.
        """
        over, error = excess - self.mean, self.error
        if error <= 0:
            return max(0.0, over)
        ratio = over / error
        below = 0.5 * math.erfc(ratio / math.sqrt(2))
        return over * (1 - below) + error * math.exp(-0.5 * ratio**2) / math.sqrt(2 * math.pi)

    def remaining(self, excess: float, closed: float) -> float:
        """What remains beyond this over what an effect closes, 1 at most.

        Args:
            excess: Excess misfit of a hypothesis.
            closed: Excess misfit that comes back without one of its effects.
        """
        rest = max(0.0, excess - self.mean) + 2 * self.error
        return min(1.0, max(rest, NOTHING) / max(closed, 1e-9))


NO_BASELINE = BaselineMisfit()


def baseline_misfit(square: Tensor, group: Tensor, others: int) -> BaselineMisfit:
    """From the spread between blocks: what a simulator gets wrong differs between recordings.

    Args:
        square: [N] |W e|^2 / D of segments of baseline recordings.
        group: [N] their blocks.
        others: Blocks of the new recordings.
    """
    root = square.clamp_max(CAP).sqrt()
    means = torch.stack([root[group == g].mean() for g in group.unique()])
    spread = float(means.std()) if len(means) > 1 else 0.0
    return BaselineMisfit(float(means.mean()) - 1, spread / others**0.5)


def typical(square: Tensor) -> float:
    """Median of |W e|^2 / D of segments [N]."""
    return float(square.median())
