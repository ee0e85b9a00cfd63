"""Frames by MuJoCo's renderer, in this process."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Sequence

import mujoco
from numpy.typing import NDArray

from buggy_rl.viz.film.cameras import View
from buggy_rl.viz.film.colours import CAR, GHOST
from buggy_rl.viz.film.painter import Painter
from buggy_rl.viz.film.scene import Look, Scene
from buggy_rl.viz.film.shot import Shot

MOST_GEOMS = 20_000  # of a frame


class Renderer:
    """Draws shots.

    Args:
        alphas: Opacity of each car.
        size: Width and height of the frames [pixels].
    """

    def __init__(self, alphas: Sequence[float], size: tuple[int, int]) -> None:
        looks = [Look(c, a) for c, a in zip((CAR, GHOST), alphas, strict=False)]
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
        Painter(self.renderer.scene).shot(shot, self.scene.dimensions)
        return self.renderer.render()
