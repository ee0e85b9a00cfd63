"""A drive that goes on: its rows so far -> what is seen now."""

from collections import deque

import numpy as np

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film import wheels
from buggy_rl.viz.film.director import TRAIL, Director
from buggy_rl.viz.film.shot import Shot
from buggy_rl.viz.film.track import Course, Track

KEPT = 2 * TRAIL  # [s] of the past that shots are made of

LiveRow = tuple[float, tuple[float, ...], int]
"""Time [s]; pose, velocity, action [8]; index of the next waypoint."""


class LiveTrack:
    """Collects rows; wheels roll on from where they were when old rows are forgotten.

    Args:
        name: Of the car.
        course: That is followed.
        dimensions: Of the car.
    """

    def __init__(
        self, name: str, course: Course | None, dimensions: VehicleDimensions | None = None
    ) -> None:
        self._name, self._course = name, course
        self._dimensions = dimensions or VehicleDimensions()
        self._rows: deque[LiveRow] = deque()
        self._rolled = np.zeros(4)  # [rad] of the wheels up to the oldest row kept

    def add(self, row: LiveRow) -> None:
        """Takes the next row.

        Raises:
            ValueError: It is not later than the one before.
        """
        if self._rows and row[0] <= self._rows[-1][0]:
            raise ValueError(f"row at {row[0]:g} s after one at {self._rows[-1][0]:g} s")
        self._rows.append(row)
        while self._rows[-1][0] - self._rows[0][0] > KEPT:
            first = self._rows.popleft()
            self._rolled += self._between(first, self._rows[0])

    def shot(self, camera: str) -> Shot | None:
        """What is seen at the last row; None before there are two."""
        if len(self._rows) < 2:
            return None
        time, values, following = zip(*self._rows, strict=True)
        begin = np.array(time) - time[0]
        motion = np.array(values)
        track = Track(
            self._name, begin, motion[:, :3], motion[:, 3:6], motion[:, 6:],
            self._course, np.array(following),
        )  # fmt: skip
        shot = Director([track], camera, dimensions=self._dimensions).shot(track.duration)
        shot.car.roll[:] += self._rolled
        return shot

    def _between(self, one: LiveRow, other: LiveRow) -> np.ndarray:
        """By how much the wheels roll from one row to the next [4]."""
        time = np.array([one[0], other[0]])
        motion = np.array([one[1], other[1]])
        angle = wheels.steering_angle(motion[:, 7])
        return wheels.rolled(time, motion[:, 3:6], angle, self._dimensions)[-1]
