"""The tyre law over its friction N D, F / (N D) = sin(c atan(s)), and its inverse.

s = C alpha / (c D) is the normalised slip, with C the force over load and slip angle at small slip.
"""

import torch
from torch import Tensor

MOST_USED = 0.995  # [-] largest share of the friction that is inverted: beyond it s diverges


def slip_of(use: Tensor, shape: Tensor) -> Tensor:
    """Slip s >= 0 at which a tyre gives a share u of its friction: s = tan(asin(|u|) / c)."""
    return torch.tan(torch.asin(use.abs().clamp_max(MOST_USED)) / shape)


def law(slip: Tensor, shape: Tensor) -> Tensor:
    """Share of its friction that a tyre gives at s >= 0: sin(c atan(s))."""
    return torch.sin(shape * torch.atan(slip))


def slope(slip: Tensor, shape: Tensor) -> Tensor:
    """Slope of the law over that at s = 0, not below 0: cos(c atan(s)) / (1 + s^2)."""
    return torch.cos(shape * torch.atan(slip)).clamp_min(0.0) / (1 + slip.square())
