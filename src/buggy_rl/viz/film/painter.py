"""Paints on the floor of a frame: ribbons and discs, which change from frame to frame."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film.colours import CAR, CLOSED, GHOST, OPEN, PATH, Colour
from buggy_rl.viz.film.shot import Shot

FLAT = 0.0008  # [m] half height of a ribbon
PATH_WIDTH, TRAIL_WIDTH = 0.006, 0.005  # [m] half widths of ribbons
DISC = (0.022, 0.004)  # [m] radius and height of a waypoint
SHADOW = tuple((1.0 - 0.09 * layer, 0.055) for layer in range(7))  # share of its size, opacity


class Painter:
    """Adds what changes from frame to frame to a visual scene: lines and discs on the floor."""

    def __init__(self, scene: mujoco.MjvScene) -> None:
        self.scene = scene

    def shot(self, shot: Shot, dimensions: VehicleDimensions) -> None:
        """The first car's shadow and path, and where each car has been."""
        d = dimensions
        middle = d.cg_to_front_axle - d.sensor_to_cg - d.wheelbase / 2
        self.shadow(shot.rows[0].pose, middle, 1.35 * d.length, 1.7 * d.track_width)
        for points, done in shot.paths():
            self.line(points, CLOSED if done else PATH, PATH_WIDTH, 0.9)
            self.discs(points[1:], CLOSED if done else OPEN, *DISC)
        for trail, colour in zip(shot.trails, (CAR, GHOST), strict=False):
            self.line(trail, colour, TRAIL_WIDTH, 0.55)

    def line(self, points: NDArray, colour: Colour, half_width: float, alpha: float = 1.0) -> None:
        """A ribbon on the floor through points [N, 2]."""
        for (x, y), (to_x, to_y) in pairwise(points):
            length, yaw = np.hypot(to_x - x, to_y - y), np.arctan2(to_y - y, to_x - x)
            if length < 1e-6:
                continue
            cos, sin = np.cos(yaw), np.sin(yaw)
            turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
            size = [length / 2 + half_width, half_width, FLAT]
            place = [(x + to_x) / 2, (y + to_y) / 2, FLAT]
            self._add(mujoco.mjtGeom.mjGEOM_BOX, size, place, turn, colour, alpha)

    def discs(self, points: NDArray, colour: Colour, radius: float, height: float) -> None:
        """Upright cylinders at points [N, 2]."""
        for x, y in points:
            size = [radius, radius, height / 2]
            place = [x, y, height / 2]
            self._add(mujoco.mjtGeom.mjGEOM_CYLINDER, size, place, np.eye(3), colour, 1.0)

    def shadow(self, pose: Sequence[float], middle: float, length: float, width: float) -> None:
        """A soft shadow under a car at a pose; a shadow map is coarse, and slow without a GPU.

        Args:
            pose: x, y [m], yaw [rad].
            middle: Of the car, ahead of its pose [m].
            length: [m]
            width: [m]
        """
        x, y, yaw = pose
        cos, sin = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        for layer, (share, alpha) in enumerate(SHADOW):
            size = [share * length / 2, share * width / 2, FLAT / 2]
            place = [x + cos * middle, y + sin * middle, FLAT / 2 * (layer + 3)]
            self._add(mujoco.mjtGeom.mjGEOM_ELLIPSOID, size, place, turn, (0.0, 0.0, 0.0), alpha)

    def _add(self, kind, size, place, turn: NDArray, colour: Colour, alpha: float) -> None:
        scene = self.scene
        if scene.ngeom >= scene.maxgeom:
            return
        rgba = np.array([*colour, alpha], np.float32)
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom], kind, np.array(size), np.array(place), turn.flatten(), rgba
        )
        scene.ngeom += 1
