"""The range of a model's training data, and whether an input lies inside it."""

from itertools import combinations

import torch
from torch import Tensor, nn

TAIL = 5e-4  # share of the rows on each side of the range, excluded as sensor noise; chosen
BINS = 24  # cells along each input; coarse, so that minutes of driving fill them; chosen


class Envelope(nn.Module):
    """Range and pairwise occupancy of the five inputs vx, vy, yaw_rate, throttle, steering.

    A box alone contains full throttle at full lock although each was only driven without the
    other. So an input is also outside if one of the ten pairs falls into a cell of a coarse grid
    that has no training row in it or in a neighbouring cell.
    """

    def __init__(self) -> None:
        super().__init__()
        self.low = nn.Buffer(torch.full((5,), -1.0))
        self.high = nn.Buffer(torch.full((5,), 1.0))
        pairs = list(combinations(range(5), 2))
        self.occupied = nn.Buffer(torch.ones(len(pairs) * BINS * BINS, dtype=torch.bool))
        first, second = torch.tensor(pairs).T
        self.first = nn.Buffer(first, persistent=False)
        self.second = nn.Buffer(second, persistent=False)
        self.offset = nn.Buffer(torch.arange(len(pairs)) * BINS * BINS, persistent=False)

    def fit(self, rows: Tensor) -> None:
        """Fits range and occupancy to training rows [N, 5]."""
        ordered = rows.sort(0).values
        cut = int(TAIL * len(rows))
        self.low.copy_(ordered[cut])
        self.high.copy_(ordered[len(rows) - 1 - cut])
        cells = self._cells(rows)  # (N, 10)
        counts = torch.zeros_like(self.occupied, dtype=torch.float32)
        counts.index_add_(0, cells.flatten(), torch.ones(cells.numel(), device=rows.device))
        grid = (counts > 0).float().view(-1, 1, BINS, BINS)
        grown = nn.functional.max_pool2d(grid, 3, stride=1, padding=1)  # neighbouring cells
        self.occupied.copy_(grown.flatten() > 0)

    def outside(self, rows: Tensor) -> Tensor:
        """Whether inputs [*, 5] lie outside the training data; bool [*, 1]."""
        beyond = ((rows < self.low) | (rows > self.high)).any(-1)
        unseen = ~self.occupied[self._cells(rows)].all(-1)
        return (beyond | unseen).unsqueeze(-1)

    def clamp_velocity(self, velocity: Tensor, margin: float) -> Tensor:
        """Clamps a velocity [*, 3] to the training range widened by `margin` of its width."""
        room = margin * (self.high - self.low)[:3]
        return torch.clamp(velocity, self.low[:3] - room, self.high[:3] + room)

    def _cells(self, rows: Tensor) -> Tensor:
        width = (self.high - self.low).clamp_min(1e-6)
        index = ((rows - self.low) / width * BINS).long().clamp(0, BINS - 1)  # (*, 5)
        return self.offset + index[..., self.first] * BINS + index[..., self.second]
