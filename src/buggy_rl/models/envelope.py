"""What a model has seen: the range of its training data, and whether an input lies inside it."""

from itertools import combinations

import torch
from torch import Tensor, nn

TAIL = 5e-4  # share of the data on each side taken for sensor noise, not for range
BINS = 24  # cells along each input; coarse, so that honest driving fills them


class Envelope(nn.Module):
    """Range and pairwise occupancy of the five inputs vx, vy, yaw_rate, throttle, steering.

    A box alone calls full throttle with full lock known when each was driven without the other;
    so an input also counts as unknown when one of the ten pairs falls into a cell (or next to a
    cell) of a coarse grid in which there was no training sample.
    """

    low: Tensor
    high: Tensor
    occupied: Tensor
    first: Tensor
    second: Tensor
    offset: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("low", torch.full((5,), -1.0))
        self.register_buffer("high", torch.full((5,), 1.0))
        pairs = list(combinations(range(5), 2))
        self.register_buffer("occupied", torch.ones(len(pairs) * BINS * BINS, dtype=torch.bool))
        first, second = torch.tensor(pairs).T
        self.register_buffer("first", first, persistent=False)
        self.register_buffer("second", second, persistent=False)
        self.register_buffer("offset", torch.arange(len(pairs)) * BINS * BINS, persistent=False)

    def fit(self, rows: Tensor) -> None:
        """Takes range and occupancy from training rows [N, 5]."""
        ordered = rows.sort(0).values
        cut = int(TAIL * len(rows))
        self.low.copy_(ordered[cut])
        self.high.copy_(ordered[len(rows) - 1 - cut])
        cells = self._cells(rows)  # (N, 10)
        counts = torch.zeros_like(self.occupied, dtype=torch.float32)
        counts.index_add_(0, cells.flatten(), torch.ones(cells.numel(), device=rows.device))
        grid = (counts > 0).float().view(-1, 1, BINS, BINS)
        grown = nn.functional.max_pool2d(grid, 3, stride=1, padding=1)  # a cell's neighbours count
        self.occupied.copy_(grown.flatten() > 0)

    def outside(self, rows: Tensor) -> Tensor:
        """Whether inputs [*, 5] lie outside what was driven; bool [*, 1]."""
        beyond = ((rows < self.low) | (rows > self.high)).any(-1)
        unseen = ~self.occupied[self._cells(rows)].all(-1)
        return (beyond | unseen).unsqueeze(-1)

    def clamp_velocity(self, velocity: Tensor, margin: float) -> Tensor:
        """Keeps a velocity [*, 3] within the training range widened by `margin` of its width."""
        room = margin * (self.high - self.low)[:3]
        return torch.clamp(velocity, self.low[:3] - room, self.high[:3] + room)

    def _cells(self, rows: Tensor) -> Tensor:
        width = (self.high - self.low).clamp_min(1e-6)
        index = ((rows - self.low) / width * BINS).long().clamp(0, BINS - 1)  # (*, 5)
        return self.offset + index[..., self.first] * BINS + index[..., self.second]
