"""The clean top-down drawing: shows what MuJoCo's renderer does, without OpenGL."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film import wheels
from buggy_rl.viz.film.camera import FIELD
from buggy_rl.viz.film.canvas import Canvas
from buggy_rl.viz.film.colours import (
    AHEAD,
    CAR,
    CLOSED,
    FLOOR,
    GHOST_ALPHA,
    GHOSTS,
    GRID,
    OPEN,
    RGB,
    mixed,
)
from buggy_rl.viz.film.marks import AHEAD_WIDTH, FALL, TRAIL_WIDTH
from buggy_rl.viz.film.shot import Car, Frame, Shot, View

DARK, GLASS, TREAD = (0.13, 0.14, 0.16), (0.16, 0.20, 0.26), (0.42, 0.43, 0.45)
FLAT = mixed(FLOOR, (1.0, 1.0, 1.0), 0.55)  # the floor, lit
LINE = mixed(GRID, (1.0, 1.0, 1.0), 0.45)
TREADS = 6  # marks about a wheel's circumference; three at most are seen from above

# Outlines, as fractions of half the length and half the track width, about the middle.
BODY = [(-0.95, 0.26), (-0.6, 0.44), (0.1, 0.48), (0.62, 0.32), (0.95, 0.18),
        (0.95, -0.18), (0.62, -0.32), (0.1, -0.48), (-0.6, -0.44), (-0.95, -0.26)]  # fmt: skip
CABIN = [(-0.6, 0.3), (0.3, 0.32), (0.3, -0.32), (-0.6, -0.3)]
ROOF = [(-0.4, 0.25), (0.0, 0.25), (0.0, -0.25), (-0.4, -0.25)]
WING = [(-1.06, 0.86), (-0.78, 0.86), (-0.78, -0.86), (-1.06, -0.86)]
BUMPER = [(0.9, 0.5), (1.0, 0.42), (1.0, -0.42), (0.9, -0.5)]


class Drawing:
    """Draws shots from above; the view keeps its place and direction, and loses its slope.

    Args:
        dimensions: Of the cars.
        size: Width and height [pixel].
        note: What the user should know about this choice.
    """

    def __init__(
        self, dimensions: VehicleDimensions, size: tuple[int, int], note: str = ""
    ) -> None:
        self.note, self._size, self._dimensions = note, size, dimensions

    def frames(self, shots: Iterable[Shot]) -> Iterator[Frame]:
        """A frame [H, W, 3] for each shot."""
        for shot in shots:
            yield self._frame(shot)

    def close(self) -> None:
        """Nothing was started."""

    def _frame(self, shot: Shot) -> Frame:
        canvas, map_ = Canvas(self._size, FLAT), Map(shot.view, self._size)
        self._grid(canvas, map_)
        wide = map_.scale * max(1.0, shot.view.distance / 2.0)
        canvas.line(map_(shot.ahead), wide * AHEAD_WIDTH, AHEAD)
        for car, colour in reversed(list(zip(shot.cars, (CAR, *GHOSTS), strict=False))):
            trail = np.concatenate([car.trail, [[car.x, car.y]]])
            canvas.line(map_(trail), wide * TRAIL_WIDTH, mixed(colour, FLAT, 0.3))
        self._waypoints(canvas, map_, shot)
        for ghost, colour in zip(shot.ghosts, GHOSTS, strict=False):
            self._car(canvas, map_, ghost, colour, GHOST_ALPHA + 0.1)
        self._car(canvas, map_, shot.car, CAR, 1.0)
        return np.asarray(canvas.reduced())

    def _grid(self, canvas: Canvas, map_: "Map") -> None:
        """A line every metre."""
        reach = math.ceil(math.hypot(*self._size) / 2 / map_.scale)
        x, y = round(map_.x), round(map_.y)
        for step in range(-reach, reach + 1):
            for ends in (
                [(x + step, y - reach), (x + step, y + reach)],
                [(x - reach, y + step), (x + reach, y + step)],
            ):
                canvas.line(map_(np.array(ends)), 1.0, LINE)

    def _waypoints(self, canvas: Canvas, map_: "Map", shot: Shot) -> None:
        """An open one is a ring of full size, a closed one a smaller disc of another colour."""
        for centre, age in zip(map_(shot.waypoints), shot.closed_for, strict=True):
            shrunk = float(np.clip(age / FALL, 0.0, 1.0))
            radius = map_.scale * (0.036 - 0.012 * shrunk)
            if age < 0:
                canvas.disc(centre, radius, OPEN)
                canvas.disc(centre, 0.5 * radius, mixed(OPEN, (1.0, 1.0, 1.0), 0.75))
            else:
                canvas.disc(centre, radius, CLOSED)

    def _car(self, canvas: Canvas, map_: "Map", car: Car, paint: RGB, alpha: float) -> None:
        places = wheels.places(self._dimensions)
        half = np.array([self._dimensions.length / 2, self._dimensions.track_width / 2])
        middle = np.array([places[:, 0].mean(), 0.0])

        def part(outline, colour):
            canvas.polygon(map_(_placed(middle + half * outline, car)), colour, alpha)

        axles = [[(p[0], p[1]), (p[0], -p[1])] for p in places[[0, 2]]]
        for axle in axles:
            width = map_.scale * 0.008
            canvas.line(map_(_placed(np.array(axle), car)), width, DARK, alpha)
        for place, roll, angle in zip(places, car.roll, (1, 1, 0, 0), strict=True):
            self._wheel(canvas, map_, car, place, roll, angle * car.steering_angle, alpha)
        part(BUMPER, DARK)
        part(BODY, paint)
        part(CABIN, GLASS)
        part(ROOF, paint)
        part(WING, mixed(paint, (0.0, 0.0, 0.0), 0.15))

    def _wheel(self, canvas, map_, car: Car, place, roll: float, angle: float, alpha: float):
        """A tyre, and the treads on its upper half."""
        radius, width = self._dimensions.wheel_radius, self._dimensions.wheel_width / 2
        cos, sin = math.cos(angle), math.sin(angle)
        turn = np.array([[cos, sin], [-sin, cos]])  # of row vectors, to the left

        def shape(outline, colour):
            points = place + np.array(outline) @ turn
            canvas.polygon(map_(_placed(points, car)), colour, alpha)

        shape([(-radius, -width), (radius, -width), (radius, width), (-radius, width)], DARK)
        for tread in range(TREADS):
            about = roll + 2 * math.pi * tread / TREADS  # from the top, forwards
            if math.cos(about) > 0.15:
                x, thick = radius * math.sin(about), 0.09 * radius * math.cos(about)
                ends = [(x - thick, -width), (x + thick, -width), (x + thick, width),
                        (x - thick, width)]  # fmt: skip
                shape(ends, TREAD)


class Map:
    """From the floor to pixels of a view.

    Args:
        view: The camera; a sloping one is raised to see about as much from above.
        size: Width and height [pixel].
    """

    def __init__(self, view: View, size: tuple[int, int]) -> None:
        straight_down = view.elevation < -1.5
        height = view.distance * (1.0 if straight_down else 1.55)
        self.scale = size[1] / (2 * height * math.tan(FIELD / 2))  # [pixel/m]
        self.x, self.y, self._centre = view.x, view.y, np.array(size) / 2
        cos, sin = math.cos(view.azimuth), math.sin(view.azimuth)
        # The direction of view is up in the picture: right is (sin, -cos), up (cos, sin).
        self._turn = np.array([[sin, -cos], [-cos, -sin]])  # rows: right, down

    def __call__(self, points: NDArray[Any]) -> NDArray[Any]:
        """Pixels [K, 2], x right and y down, of points [K, 2] in the world frame [m]."""
        moved = np.asarray(points, float) - [self.x, self.y]
        return self._centre + self.scale * moved @ self._turn.T


def _placed(points: NDArray[Any], car: Car) -> NDArray[Any]:
    """From the car's frame to the world."""
    cos, sin = math.cos(car.yaw), math.sin(car.yaw)
    return np.array([car.x, car.y]) + points @ np.array([[cos, sin], [-sin, cos]])
