"""The wheel axis of tensors: front left, front right, rear left, rear right; the first axis.

It stands before the batch, so that a number per environment broadcasts over its wheels.
Vectors at the wheels are [2, 4, *]: along the wheel (forward), across it (to the left).
"""

import torch
from torch import Tensor

LEFT_RIGHT = (1.0, -1.0)  # y of the wheels of an axle in half track widths


def per_wheel(front: Tensor, rear: Tensor) -> Tensor:
    """[4, *] from the values [*] of the front and of the rear wheels."""
    front, rear = torch.broadcast_tensors(front, rear)
    return torch.stack([front, front, rear, rear])


def sides(like: Tensor) -> Tensor:
    """[2, *1]: +1 for the left wheel of an axle and -1 for the right; ones beside the batch."""
    signs = torch.tensor(LEFT_RIGHT, dtype=like.dtype, device=like.device)
    return signs.reshape(2, *[1] * like.dim())
