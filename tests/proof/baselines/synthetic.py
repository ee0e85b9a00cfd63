"""Columns of which it is known what they consist of."""

import torch

from buggy_rl.estimation.hypothesis import Library
from buggy_rl.proof.baselines.columns import Columns, Feature

NAMES = ("steering_gain", "viscous_drag", "steering_lag")  # the last one has no negative
SHAPE = (60, 10, 6)


def synthetic(coefficients, noise: float = 1.0, seed: int = 0) -> Columns:
    """Random columns, and the sum of them with these coefficients, under noise."""
    generator = torch.Generator().manual_seed(seed)
    x, n = (torch.randn(k, *SHAPE, generator=generator, dtype=torch.float64) for k in (3, 1))
    weights = torch.tensor(coefficients, dtype=torch.float64)
    features = [
        Feature(
            name,
            Library().hypothesis([name]).coordinates[:-1],
            (1.0,),
            (True,),
            name != "steering_lag",
        )
        for name in NAMES
    ]
    return Columns(features, torch.einsum("f,fnkc->nkc", weights, x) + noise * n[0], x)
