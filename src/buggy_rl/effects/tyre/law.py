"""The law of a tyre, F = D sin(c atan(s)) over its bound D, and its inverse.

Slip is s = C slip / (c D), C the force over the slip where the slip is small.
"""

import torch
from torch import Tensor

MOST_USED = 0.995  # of its bound; a tyre that gives more is taken to slide


def slip_of(use: Tensor, shape: Tensor) -> Tensor:
    """Slip s >= 0 at which a tyre gives a share u of its bound: s = tan(asin(|u|) / c)."""
    return torch.tan(torch.asin(use.abs().clamp_max(MOST_USED)) / shape)


def law(slip: Tensor, shape: Tensor) -> Tensor:
    """Share of its bound that a tyre gives at s >= 0: sin(c atan(s))."""
    return torch.sin(shape * torch.atan(slip))


def slope(slip: Tensor, shape: Tensor) -> Tensor:
    """Slope of the law over that at no slip, not below 0: cos(c atan(s)) / (1 + s^2)."""
    return torch.cos(shape * torch.atan(slip)).clamp_min(0.0) / (1 + slip.square())
