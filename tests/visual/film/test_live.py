"""What MuJoCo's viewer is given; a window needs a screen, a scene does not."""

import mujoco
import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import live
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.drawing import marks
from buggy_rl.visual.film.scene import Scene
from tests.visual.film.tracks import on_course, straight


def test_without_a_screen_it_is_refused_with_a_way_out(monkeypatch):
    monkeypatch.setattr(live.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ValueError, match=r"needs a screen.*live=browser.*output=film\.mp4"):
        live.play(Director([straight()]))


@pytest.mark.parametrize("room", [1000, 5])
def test_marks_are_added_as_far_as_there_is_room(room):
    drawn = marks(Director([on_course()]).shot(1.0), VehicleDimensions())
    scene = mujoco.MjvScene(Scene(VehicleDimensions()).model, maxgeom=room)
    live.add(scene, drawn)
    assert scene.ngeom == min(room, len(drawn))
    for index in range(scene.ngeom):
        geom, position, colour = scene.geoms[index], drawn.position[index], drawn.colour[index]
        np.testing.assert_allclose(geom.pos, position, atol=1e-6)
        np.testing.assert_allclose(geom.rgba, colour, atol=1e-6)
