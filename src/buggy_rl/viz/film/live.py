"""Shows a film in MuJoCo's own viewer, where there is a screen."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import os
import sys
import time

import numpy as np

from buggy_rl.viz.film.film import GHOST_ALPHA, FilmConfig, tracks

PERIOD = 1 / 60  # [s] between two pictures


def show(config: FilmConfig) -> None:
    """Plays tracks again and again until the window is closed.

    Raises:
        ValueError: There is no screen.
    """
    if sys.platform == "linux" and not os.environ.get("DISPLAY"):
        raise ValueError("live=true needs a screen (DISPLAY is not set): write a film instead")
    os.environ["MUJOCO_GL"] = "glfw"
    from mujoco import viewer

    from buggy_rl.viz.film.colours import CAR, GHOST
    from buggy_rl.viz.film.painter import Painter
    from buggy_rl.viz.film.scene import Look, Scene
    from buggy_rl.viz.film.shot import Shot

    found = tracks(config, config.ghost)
    scene = Scene([Look(CAR), Look(GHOST, GHOST_ALPHA)][: len(found)])
    longest = max(track.duration for track in found)
    with viewer.launch_passive(scene.model, scene.data) as window:
        window.cam.distance, window.cam.elevation = 1.6, -30.0
        begun = time.monotonic()
        while window.is_running():
            now = (config.speed * (time.monotonic() - begun)) % longest
            rows = [track.at(np.array([now]), scene.dimensions)[0] for track in found]
            scene.set(rows)
            window.cam.lookat[:2] = rows[0].pose[:2]
            drawn = window.user_scn
            assert drawn is not None
            drawn.ngeom = 0
            trails = [np.empty((0, 2))] * len(found)
            shot = Shot([t.name for t in found], rows, trails, found[0].waypoints)
            Painter(drawn).shot(shot, scene.dimensions)
            window.sync()
            time.sleep(PERIOD)
