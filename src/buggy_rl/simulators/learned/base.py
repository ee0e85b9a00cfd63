"""One step of learned dynamics, with the buffers that are saved with the weights."""

from abc import abstractmethod
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor, nn

from buggy_rl.core.longitudinal import ONE_WAY, ONE_WAY_REST, LongitudinalCommand
from buggy_rl.core.vehicle import planar_norm

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
        pairs = torch.tensor(list(combinations(range(5), 2)))
        self.occupied = nn.Buffer(torch.ones(len(pairs) * BINS * BINS, dtype=torch.bool))
        # Of each cell its distance, and those of the next ones: second input, first, both.
        self.distances = nn.Buffer(torch.zeros(len(self.occupied), 4), persistent=False)
        self.inputs = nn.Buffer(pairs.T.flatten(), persistent=False)  # first ones, second ones
        offset = torch.arange(float(len(pairs))) * BINS * BINS
        self.offset = nn.Buffer(offset, persistent=False)

    def fit(self, rows: Tensor) -> None:
        """Fits range and occupancy to training rows [N, 5]."""
        ordered = rows.sort(0).values
        cut = int(TAIL * len(rows))
        self.low.copy_(ordered[cut])
        self.high.copy_(ordered[len(rows) - 1 - cut])
        cells = self._flat(self._places(self._share(rows)).floor().clamp(0, BINS - 1))  # (N, 10)
        counts = torch.zeros_like(self.occupied, dtype=torch.float32)
        counts.index_add_(0, cells.flatten(), torch.ones(cells.numel(), device=rows.device))
        grid = (counts > 0).float().view(-1, 1, BINS, BINS)
        grown = nn.functional.max_pool2d(grid, 3, stride=1, padding=1)  # neighbouring cells
        self.occupied.copy_(grown.flatten() > 0)
        self._measure()

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        super()._load_from_state_dict(*args, **kwargs)
        self._measure()

    def measured(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """Whether inputs [*, 5] lie outside the training data, and how far.

        Returns:
            Bool [*, 1]; and [*, 1] in widths of the range: the sum over inputs of the distance from
            their range, and over pairs of that from the nearest cell that is not outside, linear
            between the centres of cells, so with a slope.
        """
        share = self._share(rows)
        beyond = (share - share.clamp(0.0, 1.0)).abs()
        between = (self._places(share) - 0.5).clamp(0.0, BINS - 1.0)  # centres of cells
        # What is no number has no cell: any will do, its distance is no number either.
        cell = between.detach().nan_to_num(0.0).floor().clamp_max(BINS - 2)
        x, y = (between - cell).chunk(2, -1)  # (*, 10)
        corners = nn.functional.embedding(self._flat(cell), self.distances)  # (*, 10, 4)
        here, beside, ahead, across = corners.unbind(-1)
        away = torch.lerp(torch.lerp(here, beside, y), torch.lerp(ahead, across, y), x)
        second = y >= 0.5
        own = torch.where(
            x >= 0.5, torch.where(second, across, ahead), torch.where(second, beside, here)
        )
        inside = (beyond == 0.0).all(-1) & (own == 0.0).all(-1)  # what is no number is not
        return ~inside.unsqueeze(-1), (beyond.sum(-1) + away.sum(-1)).unsqueeze(-1)

    def _share(self, rows: Tensor) -> Tensor:
        """Inputs [*, 5] in widths of their range, from its lower end."""
        return (rows - self.low) / (self.high - self.low).clamp_min(1e-6)

    def _places(self, share: Tensor) -> Tensor:
        """Places [*, 20] on the grids of all pairs, in cells: first inputs, then second ones."""
        return (share * BINS).index_select(-1, self.inputs)

    def _flat(self, cells: Tensor) -> Tensor:
        """Numbers [*, 10] of cells [*, 20], in the order of `occupied`."""
        first, second = cells.chunk(2, -1)
        return (torch.add(second, first, alpha=BINS) + self.offset).long()

    def _measure(self) -> None:
        """Distances of cells from the nearest one that is not outside, in widths of the range."""
        grids = self.occupied.view(-1, BINS, BINS).cpu().numpy()
        away = np.stack([np.asarray(distance_transform_edt(~grid)) for grid in grids])
        flat = torch.from_numpy(away).flatten().to(self.distances) / BINS
        self.distances.copy_(torch.stack([flat.roll(-n) for n in (0, 1, BINS, BINS + 1)], -1))

    def clamp_velocity(self, velocity: Tensor, margin: float) -> Tensor:
        """Clamps a velocity [*, 3] to the training range widened by `margin` of its width."""
        room = margin * (self.high - self.low)[:3]
        return torch.clamp(velocity, self.low[:3] - room, self.high[:3] + room)


INPUTS = 5  # vx, vy, yaw_rate, throttle, steering
REST_SPEED = 0.06  # [m/s] highest speed of a standing car: 2.4 times the camera's noise
REST_YAW_RATE = 0.15  # [rad/s] highest yaw rate of a standing car: 5 times the gyroscope noise
CREEP_SPEED = 1.0  # [m/s] speed below which a car without drive loses speed; chosen
NO_DRIVE = -0.98  # highest throttle without drive: 1 % of it, a sixteenth of DART's deadband
MARGIN = 0.1  # of the training range's width, by which a rollout may leave it; chosen


def one_way_throttle(throttle: Tensor, rest: float) -> Tensor:
    """Throttle [*] as of a one-way car, -1 is no drive: with reverse |u| - 1, both ways alike."""
    return throttle if rest == ONE_WAY_REST else throttle.abs() - 1


class DynamicsModel(nn.Module):
    """v' = v + s_out * f((history - mean) / s_in), constrained at rest and to the training range.

    A bare network creeps and turns at zero throttle, and may diverge outside its training range.
    Three constraints prevent it: a slow car without drive over the whole history loses at least
    the speed that recorded cars lose while coasting; it stands still once it is slower than the
    sensor noise; velocities stay within the training range widened by `MARGIN`.

    Of a command with reverse "without drive" is near 0, not at the lower end. Buffers are fitted to
    the training data and saved with the weights.
    """

    command: LongitudinalCommand = ONE_WAY
    """What the throttle of the training data is."""

    def __init__(self, rows: int) -> None:
        super().__init__()
        self.rows = rows  # of history, the present one included
        self.input_mean = nn.Buffer(torch.zeros(INPUTS))
        self.input_scale = nn.Buffer(torch.ones(INPUTS))
        self.output_scale = nn.Buffer(torch.ones(3))
        self.rest_throttle = nn.Buffer(
            torch.tensor(NO_DRIVE)
        )  # highest at rest, of `one_way_throttle`
        self.coast_loss = nn.Buffer(torch.tensor(0.001))  # [m/s] a step, at least
        self.envelope = Envelope()

    @abstractmethod
    def network(self, history: Tensor) -> Tensor:
        """Normalised history [*, rows, 5], oldest first -> normalised change of velocity [*, 3]."""

    def change(self, history: Tensor) -> Tensor:
        """The unconstrained change of velocity [*, 3] in a step, which is trained."""
        return self.network((history - self.input_mean) / self.input_scale) * self.output_scale

    def forward(self, history: Tensor) -> Tensor:
        """Returns the velocity one step later.

        Args:
            history: [*, rows, 5] vx, vy [m/s], yaw_rate [rad/s], throttle, steering; oldest first,
                the last row is the present.

        Returns:
            [*, 3] vx, vy [m/s], yaw_rate [rad/s].
        """
        velocity = history[..., -1, :3]
        following = self.envelope.clamp_velocity(velocity + self.change(history), MARGIN)
        vx, vy, yaw_rate = velocity.unbind(-1)
        speed = planar_norm(vx, vy)
        highest_throttle = one_way_throttle(history[..., 3], self.command.rest).amax(-1)
        # Without drive: v' shrinks to at most |v| - loss, and yaw rate with it.
        limit = (speed - self.coast_loss).clamp_min(0.0)
        shrink = limit / planar_norm(following[..., 0], following[..., 1]).clamp_min(1e-6)
        coasting = (highest_throttle <= NO_DRIVE) & (speed < CREEP_SPEED)
        shrink = torch.where(coasting, shrink.clamp_max(1.0), 1.0)
        slow = (speed < REST_SPEED) & (yaw_rate.abs() < REST_YAW_RATE)
        standing = slow & (highest_throttle <= self.rest_throttle)
        return torch.where(standing, 0.0, shrink).unsqueeze(-1) * following


class Ensemble(DynamicsModel):
    """Mean of its members' changes of velocity."""

    def __init__(self, members: Sequence[DynamicsModel]) -> None:
        super().__init__(members[0].rows)
        self.members = members
        self._registered = nn.ModuleList(members)

    def network(self, history: Tensor) -> Tensor:
        # Members share the ensemble's normalisation: they are trained on the same data.
        return torch.stack([member.network(history) for member in self.members]).mean(0)
