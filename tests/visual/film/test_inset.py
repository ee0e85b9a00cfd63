"""The corner with names, speed and commands."""

from dataclasses import replace

import numpy as np

from buggy_rl.visual.film.canvas import Inset, captioned
from buggy_rl.visual.film.director import Director
from tests.visual.film.tracks import circle, straight

GREY = np.full((480, 640, 3), 120, np.uint8)


def drawn(**changes):
    shot = Director([straight()]).shot(1.0)
    return Inset().on(GREY, replace(shot, car=replace(shot.car, **changes)))


def reddish(frame):
    """Columns of pixels of the bars' colour in the lower left corner."""
    corner = frame[-60:, :220].astype(int)
    return np.flatnonzero(((corner[..., 0] - corner[..., 1]) > 60).any(0))


def test_only_the_corners_change():
    frame = drawn()
    changed = (frame != GREY).any(-1)
    assert changed[-100:, :220].any()
    assert changed[:40, -100:].any()
    assert not changed[60:300].any()
    assert (GREY == 120).all()


def test_steering_to_the_left_fills_to_the_left():
    rest = {"throttle": -1.0}
    left, right = reddish(drawn(steering=1.0, **rest)), reddish(drawn(steering=-1.0, **rest))
    assert left.mean() < right.mean()


def test_more_drive_fills_more():
    widths = [len(reddish(drawn(throttle=t, steering=0.0))) for t in (-1.0, 0.0, 1.0)]
    assert widths[0] < widths[1] < widths[2]


def test_a_ghost_has_a_row_of_its_own():
    one = Inset().on(GREY, Director([straight()]).shot(1.0))
    two = Inset().on(GREY, Director([straight(), circle(name="ghost")]).shot(1.0))
    heights = [int((f != GREY).any(-1)[:, :220].any(1).sum()) for f in (one, two)]
    assert heights[1] > heights[0] + 10


def test_it_grows_with_the_picture():
    large = np.full((960, 1280, 3), 120, np.uint8)
    shot = Director([straight()]).shot(1.0)
    small = int((Inset().on(GREY, shot) != 120).any(-1).sum())
    assert 3.5 < int((Inset().on(large, shot) != 120).any(-1).sum()) / small < 4.5


def test_a_caption_is_a_line_at_the_top():
    frame = captioned(GREY, "steering dead time: 60 ms")
    changed = (frame != GREY).any(-1)
    assert changed[10:40, 250:390].any()
    assert not changed[60:].any()
    assert captioned(GREY, "") is GREY


def test_a_caption_too_long_for_the_picture_is_cut():
    assert captioned(GREY, "long " * 60).shape == GREY.shape
