"""A path for the car: waypoints in the world frame, open or closed, from a file and to it."""

import csv
import math
import os
from typing import List, NamedTuple, Sequence, Tuple, Union

import numpy as np

FEWEST = 3  # waypoints of a path: a tangent needs a neighbour on either side
Points = Union[np.ndarray, Sequence[Sequence[float]]]
SAME_PLACE = 1e-6  # [m] a last row this near to the first closes the path


class Tables(NamedTuple):
    """What following looks up, one row for each waypoint and for those shown beyond the last."""

    points: np.ndarray
    """[R, 2] float32 x, y [m]."""
    turned: np.ndarray
    """[R, 2] float32 y, -x [m]: the points turned to the right by a quarter."""
    tangents: np.ndarray
    """[R, 2] float32 unit vectors along the path, through the neighbours of each waypoint."""
    along: np.ndarray
    """[R, 2] float32 unit vectors of the straight pieces that end at each waypoint."""
    length: np.ndarray
    """[R] float32 of those pieces [m]."""


class Path:
    """Waypoints to follow.

    Args:
        points: [W, 2] x, y [m], at least 3.
        closed: The path goes on from its last waypoint to its first.
        name: For messages.

    Raises:
        ValueError: There are too few points, one is not finite, or one repeats its neighbour.
    """

    def __init__(self, points: Points, closed: bool, name: str = "path") -> None:
        self.points = np.asarray(points, np.float32)
        self.closed, self.name = closed, name
        if self.points.ndim != 2 or self.points.shape[1] != 2 or len(self.points) < FEWEST:
            shape = list(self.points.shape)
            raise ValueError(f"{name}: waypoints have shape {shape}: needed are [3 or more, 2]")
        for row, point in enumerate(self.points):
            if not np.isfinite(point).all():
                raise ValueError(f"{name}: waypoint {row} is not finite")
        for kind, chord in (
            ("repeats its neighbour", self._steps()),
            ("turns back", self._chords()),
        ):
            short = np.flatnonzero(np.hypot(chord[:, 0], chord[:, 1]) < SAME_PLACE)
            if len(short):
                raise ValueError(f"{name}: the path {kind} at waypoint {short[0]}: take it out")

    def __len__(self) -> int:
        return len(self.points)

    def placed(self, pose: Sequence[float]) -> "Path":
        """The same path for a car that stands at `pose` (x, y [m], yaw [rad]) instead of at 0."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        own = self.points.astype(np.float64)
        moved = [x + cos * own[:, 0] - sin * own[:, 1], y + sin * own[:, 0] + cos * own[:, 1]]
        return Path(np.stack(moved, -1), self.closed, self.name)

    def tables(self, ahead: int) -> Tables:
        """The waypoints and `ahead` more: a closed path again, an open one straight on."""
        points = self._extended(ahead)
        step = np.diff(np.concatenate([self._before(), points]), axis=0)
        chord = self._chords(ahead)
        length = _norm(step)
        turned = np.stack([points[:, 1], -points[:, 0]], -1)
        return Tables(
            np.ascontiguousarray(points),
            np.ascontiguousarray(turned),
            chord / _norm(chord)[:, None],
            step / length[:, None],
            length,
        )

    def _before(self) -> np.ndarray:
        """[1, 2] the waypoint before the first; an open path comes to it straight."""
        return self.points[-1:] if self.closed else 2 * self.points[:1] - self.points[1:2]

    def _extended(self, ahead: int) -> np.ndarray:
        """[W + ahead, 2]."""
        count = len(self.points)
        if self.closed:
            return self.points[np.arange(count + ahead) % count]
        run = np.arange(1, ahead + 1, dtype=np.float32)[:, None]
        beyond = self.points[-1] + run * (self.points[-1] - self.points[-2])
        return np.concatenate([self.points, beyond])

    def _steps(self) -> np.ndarray:
        """[W or W - 1, 2] from each waypoint to the next."""
        return np.diff(self._extended(1 if self.closed else 0), axis=0)

    def _chords(self, ahead: int = 0) -> np.ndarray:
        """[W + ahead, 2] from each waypoint's neighbour before it to the one behind."""
        points = np.concatenate([self._before(), self._extended(ahead + 1)])
        return points[2:] - points[:-2]


def _norm(vectors: np.ndarray) -> np.ndarray:
    """[R] lengths of vectors [R, 2], float32, rounded as PyTorch's `norm` with fused multiply-add.

    A tangent that differs in its last bit closes one waypoint in a million a step apart.
    """
    x, y = vectors[:, 0], vectors[:, 1].astype(np.float64)
    return np.sqrt(((x * x).astype(np.float64) + y * y).astype(np.float32))


def load_path(file: str) -> Path:
    """Reads a CSV with columns x, y [m]; the path is closed when its last row repeats its first.

    Raises:
        ValueError: It is no such file; the message names file and row.
    """
    if not os.path.isfile(file):
        raise ValueError(
            f"there is no path file {file}: name a CSV with columns x, y, as "
            "scripts/export_policy.py writes beside a policy"
        )
    with open(file, newline="") as stream:
        rows = list(csv.DictReader(stream))
    if not rows or not {"x", "y"} <= set(rows[0]):
        given = ", ".join(str(name) for name in rows[0]) if rows else "no rows"
        raise ValueError(
            f"{file} has {given}: it needs columns x and y and a row for each waypoint"
        )
    points = [_point(row, file, number) for number, row in enumerate(rows, 2)]
    (x, y), (last_x, last_y) = points[0], points[-1]
    closed = math.hypot(x - last_x, y - last_y) < SAME_PLACE
    name = os.path.splitext(os.path.basename(file))[0]
    return Path(points[:-1] if closed else points, closed, name)


def _point(row: dict, file: str, number: int) -> Tuple[float, float]:
    try:
        x, y = float(row["x"]), float(row["y"])
        if math.isfinite(x) and math.isfinite(y):
            return x, y
    except (TypeError, ValueError):
        pass  # said below, as for numbers that are not finite
    given = "{}, {}".format(row["x"], row["y"])
    raise ValueError(f"{file}, row {number}: x, y are {given}, not two finite numbers [m]")


def path_lines(path: Path) -> List[str]:
    """The lines of a file that `load_path` reads back without a difference."""
    points = np.concatenate([path.points, path.points[:1]]) if path.closed else path.points
    return ["x,y"] + [f"{float(x):.9g},{float(y):.9g}" for x, y in points]
