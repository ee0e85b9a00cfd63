"""Path, trails, waypoints and shadows as arrays of geoms for any MuJoCo scene."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film import wheels
from buggy_rl.viz.film.colours import AHEAD, CAR, CLOSED, GHOST_ALPHA, GHOSTS, OPEN, RGB
from buggy_rl.viz.film.shot import Car, Points, Shot

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
    """Of everything in a shot that is not a car."""
    wide = max(1.0, shot.view.distance / 2.0)  # from far away lines stay as wide in the picture
    ahead = _ribbon(shot.ahead, wide * AHEAD_WIDTH, 0.0008, AHEAD)
    trails = [_ribbon(shot.car.trail, wide * TRAIL_WIDTH, 0.0016, CAR)]
    shadows = _shadow(shot.car, 1.0, dimensions)
    for ghost, colour, height in zip(shot.ghosts, GHOSTS, GHOST_TRAILS, strict=False):
        trails.append(_ribbon(ghost.trail, wide * TRAIL_WIDTH, height, colour))
        shadows += _shadow(ghost, GHOST_ALPHA, dimensions)
    return _joined([ahead, *trails, *_waypoints(shot), *shadows])


def _shadow(car: Car, darkness: float, dimensions: VehicleDimensions) -> list[Marks]:
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
