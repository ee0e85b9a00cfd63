"""Means over segments of drives, whose neighbours go together."""

import torch
from torch import Tensor

from buggy_rl.estimation.misfit import CAP
from buggy_rl.estimation.noise_model import NoiseModel


def roots(noise: NoiseModel, residual: Tensor) -> Tensor:
    """|W e| / sqrt(D) [C, N] of residuals [C, N, K, 6], at most sqrt(`CAP`); 1 is noise."""
    return noise.whiten(residual).square().mean(-1).clamp_max(CAP).sqrt()


def mean_of_blocks(values: Tensor, group: Tensor) -> tuple[float, float]:
    """Mean of values [N] block by block [N], and its standard error; infinite of a single block."""
    means = torch.stack([values[group == number].mean() for number in group.unique()])
    if len(means) < 2:
        return float(means.mean()), float("inf")
    return float(means.mean()), float(means.std() / len(means) ** 0.5)
