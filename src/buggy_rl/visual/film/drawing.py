"""The clean top-down drawing and its marks, without OpenGL."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.camera import FIELD
from buggy_rl.visual.film.canvas import (
    AHEAD,
    CAR,
    CLOSED,
    FLOOR,
    GHOST_ALPHA,
    GHOSTS,
    GRID,
    OPEN,
    RGB,
    Canvas,
    mixed,
)
from buggy_rl.visual.film.shot import Frame, Points, Shot, ShownCar, View

ELLIPSOID, CYLINDER, BOX = 4, 5, 6  # mujoco.mjtGeom
AHEAD_WIDTH, TRAIL_WIDTH = 0.028, 0.016  # [m]
GHOST_TRAILS = 0.0012, 0.0014  # [m] heights that keep ribbons apart
PILLAR, DISC = 0.09, 0.004  # [m] height of an open and of a closed waypoint
FALL = 0.25  # [s] in which a closed one goes down
SUN = (0.35, 0.45)  # [m] that a shadow falls aside for each metre of height, along x and y
SOFTNESS = (0.8, 1.0, 1.2, 1.4)  # sizes of the layers of a shadow, whose edge is soft so
DARKNESS = 0.11  # of each layer


@dataclass(frozen=True)
class Marks:
    """N geoms without physics."""

    kind: NDArray[Any]
    """[N] ELLIPSOID, CYLINDER or BOX."""
    size: NDArray[Any]
    """[N, 3] half sizes of a box or ellipsoid; radius, half height, 0 of a cylinder [m]."""
    position: NDArray[Any]
    """[N, 3] m"""
    yaw: NDArray[Any]
    """[N] rad"""
    colour: NDArray[Any]
    """[N, 4] red, green, blue, alpha."""

    def __len__(self) -> int:
        return len(self.kind)


def marks(shot: Shot, dimensions: VehicleDimensions) -> Marks:
    """Marks of everything in a shot that is not a car."""
    wide = max(1.0, shot.view.distance / 2.0)  # from far away lines stay as wide in the picture
    ahead = _ribbon(shot.ahead, wide * AHEAD_WIDTH, 0.0008, AHEAD)
    trails = [_ribbon(shot.car.trail, wide * TRAIL_WIDTH, 0.0016, CAR)]
    shadows = _shadow(shot.car, 1.0, dimensions)
    for ghost, colour, height in zip(shot.ghosts, GHOSTS, GHOST_TRAILS, strict=False):
        trails.append(_ribbon(ghost.trail, wide * TRAIL_WIDTH, height, colour))
        shadows += _shadow(ghost, GHOST_ALPHA, dimensions)
    return _joined([ahead, *trails, *_waypoints(shot), *shadows])


def _shadow(car: ShownCar, darkness: float, dimensions: VehicleDimensions) -> list[Marks]:
    """Soft ellipses under the body and each wheel, away from the sun."""
    places = wheels.places(dimensions)
    middle, radius = places.mean(0), dimensions.wheel_radius
    body = (0.95 * dimensions.length / 2, 0.55 * dimensions.track_width / 2)
    wing = (0.14 * dimensions.length / 2, 0.85 * dimensions.track_width / 2)
    tail = middle - [0.9 * dimensions.length / 2, 0.0]
    wheel = (1.05 * radius, 0.75 * dimensions.wheel_width)
    parts = [(middle, body, 1.2), (tail, wing, 2.4), *((place, wheel, 0.6) for place in places)]
    centres = np.array([part[0] for part in parts])
    cos, sin = np.cos(car.yaw), np.sin(car.yaw)
    centres = [car.x, car.y] + centres @ np.array([[cos, sin], [-sin, cos]])
    centres += np.outer([part[2] * radius for part in parts], SUN)
    halves = np.array([part[1] for part in parts])
    count = len(parts)
    return [
        Marks(
            np.full(count, ELLIPSOID),
            np.column_stack([softness * halves, np.full(count, 2e-4)]),
            np.column_stack([centres, np.full(count, 2e-3 + 2e-4 * layer)]),
            np.full(count, car.yaw),
            np.tile([0.0, 0.0, 0.0, darkness * DARKNESS], (count, 1)),
        )
        for layer, softness in enumerate(SOFTNESS)
    ]


def _ribbon(points: Points, width: float, height: float, colour: RGB) -> Marks:
    """Flat boxes from point to point; `height` [m] above the floor keeps ribbons apart."""
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)
    kept = length > 1e-4  # a car that stands leaves no trail
    step, length = step[kept], length[kept]
    middle = points[:-1][kept] + step / 2
    count = len(length)
    # Half a width longer at each end would stand out in bends; a quarter closes their gaps.
    size = np.stack([length / 2 + width / 8, np.full(count, width / 2), np.full(count, 4e-4)], -1)
    position = np.column_stack([middle, np.full(count, height)])
    rgba = np.tile([*colour, 1.0], (count, 1))
    return Marks(np.full(count, BOX), size, position, np.arctan2(step[:, 1], step[:, 0]), rgba)


def _waypoints(shot: Shot) -> list[Marks]:
    """A disc each, and on it a pillar that goes down when the waypoint is closed."""
    closed = shot.closed_for >= 0
    colour = np.where(closed[:, None], [*CLOSED, 1.0], [*OPEN, 1.0])
    upright = np.clip(1 - shot.closed_for / FALL, 0.0, 1.0)
    tall = DISC + (PILLAR - DISC) * upright
    standing = ~closed | (upright > 0)
    shade = np.tile([0.0, 0.0, 0.0, 0.25], (int(standing.sum()), 1))
    aside = tall[standing, None] / 2 * np.array(SUN)
    shadows = Marks(
        np.full(len(shade), ELLIPSOID),
        np.column_stack([np.hypot(*aside.T) + 0.011, np.full(len(shade), 0.012),
                         np.full(len(shade), 2e-4)]),
        np.column_stack([shot.waypoints[standing] + aside, np.full(len(shade), 2e-3)]),
        np.full(len(shade), np.arctan2(SUN[1], SUN[0])),
        shade,
    )  # fmt: skip
    discs = _cylinders(shot.waypoints, 0.034, np.full(len(tall), DISC), colour)
    pillars = _cylinders(shot.waypoints[standing], 0.011, tall[standing], colour[standing])
    return [discs, pillars, shadows]


def _cylinders(points: Points, radius: float, height: NDArray, colour: NDArray[Any]) -> Marks:
    count = len(points)
    size = np.stack([np.full(count, radius), height / 2, np.zeros(count)], -1)
    position = np.column_stack([points, height / 2])
    return Marks(np.full(count, CYLINDER), size, position, np.zeros(count), colour)


def _joined(parts: list[Marks]) -> Marks:
    names = ("kind", "size", "position", "yaw", "colour")
    columns = (np.concatenate([getattr(part, name) for part in parts]) for name in names)
    return Marks(*columns)


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
        """Does nothing: no process was started."""

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

    def _car(self, canvas: Canvas, map_: "Map", car: ShownCar, paint: RGB, alpha: float) -> None:
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

    def _wheel(self, canvas, map_, car: ShownCar, place, roll: float, angle: float, alpha: float):
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
    """Maps the floor to pixels of a view.

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


def _placed(points: NDArray[Any], car: ShownCar) -> NDArray[Any]:
    """Moves points from the car's frame to the world."""
    cos, sin = math.cos(car.yaw), math.sin(car.yaw)
    return np.array([car.x, car.y]) + points @ np.array([[cos, sin], [-sin, cos]])
