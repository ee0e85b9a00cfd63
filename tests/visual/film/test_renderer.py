"""From shots to pixels; what needs OpenGL is skipped where there is none."""

import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import renderer as rendering
from buggy_rl.visual.film.canvas import GHOSTS, OPEN, pixel
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.drawing import Drawing
from buggy_rl.visual.film.renderer import make_renderer, open_renderer
from tests.visual.film.tracks import circle, on_course, straight

SIZE = 160, 120


@pytest.fixture
def nothing_works(monkeypatch):
    monkeypatch.setattr(
        rendering, "probe", lambda: rendering.Probe(None, "MUJOCO_GL=egl: no library")
    )


def frames(choice, tracks, times, camera="top"):
    director = Director(tracks, camera)
    with open_renderer(choice, SIZE, len(tracks) > 1, samples=0) as renderer:
        return list(renderer.frames(director.shot(time) for time in times))


def near(frame, colour, tolerance=40):
    """How many pixels have about a colour."""
    apart = np.abs(frame.astype(int) - pixel(colour)).max(-1)
    return int((apart < tolerance).sum())


@pytest.fixture(params=["mujoco", "drawing"], scope="module")
def choice(request):
    if request.param == "mujoco" and rendering.probe().backend is None:
        pytest.skip(f"MuJoCo cannot render here: {rendering.probe().reason}; {rendering.REMEDY}")
    return request.param


def test_frames_come_in_order_one_for_each_shot(choice):
    several = frames(choice, [circle(speed=2.0)], [0.0, 0.5, 1.0], "fixed")
    assert [frame.shape for frame in several] == [(120, 160, 3)] * 3
    assert all(frame.dtype == np.uint8 for frame in several)
    (alone,) = frames(choice, [circle(speed=2.0)], [0.5], "fixed")
    np.testing.assert_array_equal(several[1], alone)
    assert (several[0] != several[1]).any()


def test_the_car_is_in_the_middle_and_red(choice):
    (frame,) = frames(choice, [straight()], [0.0])
    middle = frame[50:70, 68:92].astype(int)
    red = (middle[..., 0] > middle[..., 1] + 60) & (middle[..., 0] > middle[..., 2] + 40)
    assert red.sum() > 20
    aside = frame[:20].astype(int)
    assert not (aside[..., 0] > aside[..., 1] + 60).any()


def test_the_ghost_is_there_only_when_there_is_one(choice):
    tracks = [straight(), straight(y=0.3, name="ghost")]
    with_ghost, without = (frames(choice, chosen, [1.0])[0] for chosen in (tracks, tracks[:1]))
    blue = [
        int((frame[..., 2].astype(int) > frame[..., 0].astype(int) + 60).sum())
        for frame in (with_ghost, without)
    ]
    assert blue[0] > 30
    assert blue[1] == 0
    assert GHOSTS[0][2] > GHOSTS[0][0] + 0.3  # what the line above looks for


def test_waypoints_are_seen(choice):
    shown, none = (frames(choice, [track], [1.11])[0] for track in (on_course(), straight()))
    assert near(shown, OPEN, 60) > near(none, OPEN, 60) + 20


@pytest.mark.usefixtures("nothing_works")
def test_without_opengl_it_is_drawn_and_said_why():
    renderer = make_renderer("auto", SIZE, False, VehicleDimensions())
    assert isinstance(renderer, Drawing)
    assert "no library" in renderer.note
    assert "libegl1" in renderer.note
    assert "libgl1" in renderer.note


@pytest.mark.usefixtures("nothing_works")
def test_without_opengl_mujoco_is_refused():
    with pytest.raises(ValueError, match=r"no library.*libegl1.*renderer=drawing"):
        make_renderer("mujoco", SIZE, False, VehicleDimensions())


@pytest.mark.usefixtures("nothing_works")
def test_a_drawing_that_was_asked_for_needs_no_excuse():
    assert make_renderer("drawing", SIZE, False, VehicleDimensions()).note == ""


@pytest.mark.parametrize(
    ("choice_", "size", "said"),
    [
        ("auto", (161, 120), "even"),
        ("auto", (32, 32), "64"),
        ("gpu", SIZE, "auto, mujoco, drawing"),
    ],
)
def test_wrong_choices_are_refused(choice_, size, said):
    with pytest.raises(ValueError, match=said):
        make_renderer(choice_, size, False, VehicleDimensions())
