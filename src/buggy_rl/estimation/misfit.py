"""How far residuals of segments are from noise."""

from dataclasses import dataclass

import torch
from torch import Tensor

NOTHING = 0.05  # excess over the sensor's noise below which there is nothing left to explain
CAP = 100.0  # times the noise's variance, as which a stretch counts at most


def misfit(square: Tensor, given: Tensor | None = None) -> float:
    """Mean of |W e| / sqrt(D) of stretches, each counted as sqrt(`CAP`) at most: 1 is noise alone.

    Where a car spins, two rollouts end far apart, and one such stretch would outweigh all others.
    So it weighs no more than the cap; but it counts as closed by as much as it is.

    Args:
        square: [N] |W e|^2 / D.
        given: [N] likewise of the simulator as given, where it is to be compared with that.
    """
    root, most = square.sqrt(), CAP**0.5
    if given is None:
        # Where most stretches are beyond the cap, it is what is usual among them.
        return max(float(root.clamp_max(most).mean()), float(root.median()))
    weight = ((most - 1) / (given.sqrt() - 1).clamp_min(1e-9)).clamp_max(1.0)
    return float((1 + weight * (root - 1)).clamp_max(most).mean())


@dataclass(frozen=True)
class Usual:
    """Excess over the noise that a simulator has on drives on which it counts as right."""

    mean: float = 0.0
    error: float = 0.0
    """Standard error of the mean over as many blocks as the new drives have."""

    @property
    def most(self) -> float:
        """Excess within which new drives are as right as those."""
        return max(NOTHING, self.mean + 3 * self.error)


NOTHING_USUAL = Usual()


def usual(square: Tensor, group: Tensor, others: int) -> Usual:
    """What a simulator gets wrong differs from drive to drive: by the spread between blocks.

    Args:
        square: [N] |W e|^2 / D of stretches of drives on which the simulator counts as right.
        group: [N] their blocks.
        others: Blocks of the new drives.
    """
    root = square.clamp_max(CAP).sqrt()
    means = torch.stack([root[group == g].mean() for g in group.unique()])
    spread = float(means.std()) if len(means) > 1 else 0.0
    return Usual(max(0.0, float(means.mean()) - 1), spread / others**0.5)


def typical(square: Tensor) -> float:
    """Median of |W e|^2 / D of stretches [N]."""
    return float(square.median())
