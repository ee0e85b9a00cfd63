"""MuJoCo's interactive viewer: the film in real time, with a camera that the mouse moves."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import math
import os
import sys
import time

import mujoco
import numpy as np

from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.drawing import Marks, marks
from buggy_rl.visual.film.scene import Scene
from buggy_rl.visual.film.shot import View

PERIOD = 1 / 60  # [s] between two frames


def play(director: Director, playback: float = 1.0) -> None:
    """Plays the tracks in a window, from the beginning again at the end, until it is closed.

    Raises:
        ValueError: There is no screen.
    """
    if not has_screen():
        raise ValueError(
            "live=window needs a screen and DISPLAY is not set: live=browser needs none, or write "
            "output=film.mp4"
        )
    from mujoco import viewer

    scene = Scene(director.dimensions, ghosts=len(director.tracks) - 1)
    begin = time.monotonic()
    with viewer.launch_passive(scene.model, scene.data) as window:
        look(window.cam, director.shot(0.0).view, turned=True)
        while window.is_running():
            now = (time.monotonic() - begin) * playback % director.tracks[0].duration
            shot = director.shot(now)
            with window.lock():
                scene.place(shot)
                look(window.cam, shot.view, turned=False)
                room = window.user_scn
                assert room is not None
                room.ngeom = 0
                add(room, marks(shot, director.dimensions))
            window.sync()
            time.sleep(PERIOD)


def has_screen() -> bool:
    """Whether a window can be opened."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(named) or not sys.platform.startswith("linux")


def look(camera, view: View, turned: bool) -> None:
    """Moves the point looked at; distance and direction are the mouse's, unless `turned`."""
    camera.lookat[:] = view.x, view.y, view.z
    if turned:
        camera.distance = view.distance
        camera.azimuth, camera.elevation = math.degrees(view.azimuth), math.degrees(view.elevation)


def add(scene: mujoco.MjvScene, drawn: Marks) -> None:
    """Appends marks to a scene, as many as it has room for."""
    room = scene.maxgeom - scene.ngeom
    columns = (drawn.kind, drawn.size, drawn.position, drawn.yaw, drawn.colour)
    for kind, size, position, yaw, colour in list(zip(*columns, strict=True))[:room]:
        cos, sin = math.cos(yaw), math.sin(yaw)
        turn = np.array([cos, -sin, 0, sin, cos, 0, 0, 0, 1])
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, position, turn, colour.astype(np.float32))
        scene.ngeom += 1
