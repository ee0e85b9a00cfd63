"""Paths of different lengths in one tensor, open or closed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import torch
from numpy.typing import NDArray
from torch import Tensor

from buggy_rl.core.vehicle import rotate

SHORTEST_STEP = 0.01  # of the spacing; nearer neighbours are one point repeated
SHORTEST_CHORD = 0.001  # of the spacing, from neighbour to neighbour; below it there is no tangent


@dataclass(frozen=True)
class PathSet:
    """Paths of different lengths in one tensor.

    Raises:
        ValueError: A point is not finite or is repeated, a path has fewer than three, or turns
            back on itself.
    """

    points: Tensor
    """[P, W, 2] waypoints x, y [m]; row 0 is the start, rows from `count` on are padding."""
    count: Tensor
    """[P] int64: waypoints of each path."""
    closed: Tensor
    """[P] bool: the path goes on from its last waypoint to its first."""
    start: Tensor
    """[P, 3] pose x, y [m], yaw [rad] where a car sets off along the path."""
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        length = self.extended(1).diff(dim=1).norm(dim=-1)  # (P, W)
        chord = self.chords().norm(dim=-1)
        for index, (name, count) in enumerate(zip(self.names, self.count.tolist(), strict=True)):
            if count < 3:
                raise ValueError(f"path {name!r} has {count} waypoints: it needs at least 3")
            finite = self.points[index, :count].isfinite().all(-1)
            if not finite.all():
                row = int((~finite).nonzero()[0])
                raise ValueError(f"path {name!r}: waypoint {row} is not finite")
            steps = length[index, : count if self.closed[index] else count - 1]
            near = steps < SHORTEST_STEP * steps.median()
            if near.any():
                row = int(near.nonzero()[0])
                raise ValueError(
                    f"path {name!r}: waypoints {row} and {row + 1} are {float(steps[row]):.2g} m "
                    f"apart where {float(steps.median()):.2g} m is usual: remove the repetition"
                )
            back = chord[index, :count] < SHORTEST_CHORD * steps.median()
            if back.any():
                row = int(back.nonzero()[0])
                raise ValueError(f"path {name!r} turns back on itself at waypoint {row}")

    def __len__(self) -> int:
        return len(self.points)

    @property
    def spacing(self) -> Tensor:
        """[P] usual distance between waypoints [m]."""
        length = (self.extended(1).diff(dim=1)).norm(dim=-1)  # (P, W)
        return torch.stack(
            [row[: n - 1].median() for row, n in zip(length, self.count, strict=True)]
        )

    @property
    def largest_curvature(self) -> Tensor:
        """[P] of the circles through three waypoints in a row [1/m]: 4 area / (a b c)."""
        steps = torch.cat([self.before(), self.extended(1)], 1).diff(dim=1)  # (P, W + 1, 2)
        a, b = steps[:, :-1], steps[:, 1:]
        area = (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]).abs() / 2
        curvature = 4 * area / (a.norm(dim=-1) * b.norm(dim=-1) * (a + b).norm(dim=-1))
        used = torch.arange(curvature.shape[1]) < self.count[:, None]
        return torch.where(used, curvature, 0.0).amax(1)

    def tangents(self, ahead: int = 0) -> Tensor:
        """[P, W + ahead, 2] unit vectors along the path, through each waypoint's neighbours."""
        chord = self.chords(ahead)
        return chord / chord.norm(dim=-1, keepdim=True)

    def chords(self, ahead: int = 0) -> Tensor:
        """[P, W + ahead, 2] from each waypoint's neighbour before it to the one behind [m]."""
        points = torch.cat([self.before(), self.extended(ahead + 1)], 1)
        return points[:, 2:] - points[:, :-2]

    def before(self) -> Tensor:
        """[P, 1, 2] the waypoint before the first; an open path comes to it straight."""
        last = self.points[torch.arange(len(self)), self.count - 1]
        straight = 2 * self.points[:, 0] - self.points[:, 1]
        return torch.where(self.closed[:, None], last, straight).unsqueeze(1)

    def extended(self, ahead: int) -> Tensor:
        """[P, W + ahead, 2] with `ahead` waypoints more: closed paths again, open ones straight."""
        row = torch.arange(self.points.shape[1] + ahead)
        count, closed = self.count[:, None], self.closed[:, None]
        index = torch.where(closed, row % count, row.clamp(max=count - 1))  # (P, W + ahead)
        path = torch.arange(len(self))[:, None]
        step = self.points[path, count - 1] - self.points[path, count - 2]  # (P, 1, 2)
        beyond = torch.where(closed, 0, (row - count + 1).clamp(min=0))
        return self.points[path, index] + beyond[..., None] * step

    def mirrored(self) -> Self:
        """The same paths with left for right, each seen from its own start."""
        flip = torch.tensor([1.0, -1.0], dtype=torch.float32)
        yaw = self.start[:, None, 2].expand(self.points.shape[:2])
        own = rotate(self.points - self.start[:, None, :2], -yaw) * flip
        points = rotate(own, yaw) + self.start[:, None, :2]
        names = tuple(f"{name} mirrored" for name in self.names)
        return type(self)(points, self.count, self.closed, self.start, names)

    def placed(self, start: Tensor) -> Self:
        """The same paths from other start poses [P, 3]."""
        turn = (start - self.start)[:, None, 2].expand(self.points.shape[:2])
        points = rotate(self.points - self.start[:, None, :2], turn) + start[:, None, :2]
        return type(self)(points, self.count, self.closed, start, self.names)

    def select(self, indices: Sequence[int]) -> Self:
        """Some of the paths, in the order given."""
        chosen = torch.as_tensor(indices)
        names = tuple(self.names[i] for i in indices)
        points, count, closed = self.points[chosen], self.count[chosen], self.closed[chosen]
        return type(self)(points, count, closed, self.start[chosen], names)


def joined_paths(parts: Sequence[PathSet]) -> PathSet:
    """All paths of several sets in one."""
    width = max(part.points.shape[1] for part in parts)
    padded = [part.extended(width - part.points.shape[1]) for part in parts]
    return PathSet(
        torch.cat(padded),
        torch.cat([part.count for part in parts]),
        torch.cat([part.closed for part in parts]),
        torch.cat([part.start for part in parts]),
        tuple(name for part in parts for name in part.names),
    )


def equal_paths(names: Sequence[str], points: NDArray, closed: bool) -> PathSet:
    """Paths [P, W, 2] of equal length that leave the origin along x."""
    size = torch.full((len(points),), points.shape[1])
    flags = torch.full((len(points),), closed)
    start = torch.zeros(len(points), 3, dtype=torch.float32)
    return PathSet(torch.as_tensor(points).float(), size, flags, start, tuple(names))
