"""The queue of waypoints: which the car has closed, which it sees, how far it is from the path.

Every number that decides is a float32 computed in the order of `task/transforms/waypoints.py`, so
that a waypoint closes in the same step here as in training.
"""

import math
from typing import Optional, Tuple

import numpy as np

from buggy_rl.car.path import Path, Tables


class Waypoints:
    """Closes the waypoints that the car passes and shows the next ones.

    Waypoint w with tangent t is closed by a car at p when

        (p - w) . t > 0  and  |(p - w) x t| <= lateral_bound,

    one after the other, at most `at_once` in a step.

    Args:
        visible: Waypoints shown.
        lateral_bound: [m] beside a waypoint that still counts.
        at_once: Most that one step closes.
    """

    def __init__(self, visible: int, lateral_bound: float, at_once: int) -> None:
        self.visible, self.at_once = visible, at_once
        self._bound = np.float32(lateral_bound)
        self.closed = 0  # in the last step
        self.next = 1  # goes on over the laps of a closed path
        self._path: Optional[Path] = None
        self._count = 0  # waypoints of the path
        self._row = 1  # of the next waypoint in the tables
        self._scratch = np.empty((visible, 2), np.float32)

    def follow(self, path: Path) -> None:
        """Begins a path; its first waypoint is where the car stands."""
        self._path, self._count = path, len(path)
        self._tables: Tables = path.tables(self.visible + 1)
        self.closed, self.next, self._row = 0, 1, 1

    @property
    def completed(self) -> bool:
        """An open path has no waypoint left."""
        assert self._path is not None
        return not self._path.closed and self.next >= self._count

    def advance(self, x: np.float32, y: np.float32) -> None:
        """Closes waypoints for a car at x, y [m]."""
        assert self._path is not None
        left = self.at_once if self._path.closed else min(self.at_once, self._count - self.next)
        self.closed = 0
        while self.closed < left and self._passed(self._row + self.closed, x, y):
            self.closed += 1
        self.next += self.closed
        self._row = self.next % self._count if self._path.closed else self.next

    def _passed(self, row: int, x: np.float32, y: np.float32) -> bool:
        (wx, wy), (tx, ty) = self._tables.points[row], self._tables.tangents[row]
        dx, dy = x - wx, y - wy
        return bool(dx * tx + dy * ty > 0 and abs(dx * ty - dy * tx) <= self._bound)

    def see(self, x: np.float32, y: np.float32, yaw: np.float32, out: np.ndarray) -> None:
        """Writes the next waypoints into `out` [visible, 2]: R(-yaw) (w - p) [m]."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        rows = slice(self._row, self._row + self.visible)
        np.multiply(self._tables.points[rows], cos, out=out)
        np.multiply(self._tables.turned[rows], sin, out=self._scratch)
        np.add(out, self._scratch, out=out)
        out -= (cos * x + sin * y, cos * y - sin * x)

    def errors(self, x: np.float32, y: np.float32, yaw: np.float32) -> Tuple[float, float]:
        """Distance from the piece that ends at the next waypoint [m], and heading error [rad].

        Both are positive to the left.
        """
        along_x, along_y = self._tables.along[self._row]
        end_x, end_y = self._tables.points[self._row]
        dx, dy = x - end_x, y - end_y
        short = -(dx * along_x + dy * along_y)
        within = min(max(short, np.float32(0)), self._tables.length[self._row])
        beside = along_x * dy - along_y * dx
        distance = math.copysign(np.hypot(short - within, beside), beside)
        turn = float(yaw) - math.atan2(along_y, along_x)
        return distance, (turn + math.pi) % (2 * math.pi) - math.pi
