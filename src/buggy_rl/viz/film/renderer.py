"""Frames by MuJoCo's renderer, in this process."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Sequence

import mujoco
from numpy.typing import NDArray

from buggy_rl.viz.film.cameras import View
from buggy_rl.viz.film.colours import CAR, CLOSED, GHOST, OPEN, PATH
from buggy_rl.viz.film.painter import Painter
from buggy_rl.viz.film.scene import Look, Scene
from buggy_rl.viz.film.shot import Shot

PATH_WIDTH, TRAIL_WIDTH = 0.006, 0.005  # [m] half widths on the floor
DISC = (0.022, 0.004)  # [m] radius and height of a waypoint
MOST_GEOMS = 20_000  # of a frame


class Renderer:
    """Draws shots.

    Args:
        alphas: Opacity of each car.
        size: Width and height of the frames [pixels].
    """

    def __init__(self, alphas: Sequence[float], size: tuple[int, int]) -> None:
        self.colours = [CAR, GHOST][: len(alphas)]
        looks = [Look(c, a) for c, a in zip(self.colours, alphas, strict=True)]
        self.scene = Scene(looks, size=size)
        self.renderer = mujoco.Renderer(self.scene.model, size[1], size[0], MOST_GEOMS)
        self.camera = mujoco.MjvCamera()

    def frame(self, shot: Shot, view: View) -> NDArray:
        """[H, W, 3] uint8."""
        self.scene.set(shot.rows)
        self.camera.lookat[:] = view.lookat
        self.camera.distance, self.camera.azimuth = view.distance, view.azimuth
        self.camera.elevation = view.elevation
        self.renderer.update_scene(self.scene.data, self.camera)
        painter = Painter(self.renderer.scene)
        d = self.scene.dimensions
        middle = d.cg_to_front_axle - d.sensor_to_cg - d.wheelbase / 2
        for row, look in zip(shot.rows, self.scene.looks, strict=True):
            if look.alpha == 1.0:
                painter.shadow(row.pose, middle, 1.35 * d.length, 1.7 * d.track_width)
        for points, done in shot.paths():
            painter.line(points, CLOSED if done else PATH, PATH_WIDTH, 0.9)
            painter.discs(points[1:], CLOSED if done else OPEN, *DISC)
        for trail, colour in zip(shot.trails, self.colours, strict=True):
            painter.line(trail, colour, TRAIL_WIDTH, 0.55)
        return self.renderer.render()
