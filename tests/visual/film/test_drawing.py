"""The map of the drawing from above."""

import math

import numpy as np
import pytest

from buggy_rl.visual.film.drawing import Map
from buggy_rl.visual.film.shot import View

SIZE = 640, 480


def view(azimuth, elevation=-math.pi / 2, distance=2.0):
    return View(1.0, 2.0, 0.0, distance, azimuth, elevation)


def test_the_point_looked_at_is_in_the_middle():
    assert Map(view(0.3), SIZE)(np.array([[1.0, 2.0]]))[0].tolist() == [320.0, 240.0]


@pytest.mark.parametrize("azimuth", [0.0, 0.5, math.pi / 2, -2.0])
def test_the_direction_of_view_is_up_and_its_left_is_left(azimuth):
    map_ = Map(view(azimuth), SIZE)
    ahead = np.array([[1.0 + math.cos(azimuth), 2.0 + math.sin(azimuth)]])
    left = np.array([[1.0 - math.sin(azimuth), 2.0 + math.cos(azimuth)]])
    np.testing.assert_allclose(map_(ahead)[0], [320.0, 240.0 - map_.scale], atol=1e-9)
    np.testing.assert_allclose(map_(left)[0], [320.0 - map_.scale, 240.0], atol=1e-9)


def test_straight_down_it_shows_what_the_camera_would():
    # From 2 m with a field of 45 degrees the picture is 4 tan(22.5 degrees) high.
    assert Map(view(0.0), SIZE).scale == pytest.approx(480 / (4 * math.tan(math.radians(22.5))))
