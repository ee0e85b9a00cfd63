"""Cameras: where they look, and that they move smoothly."""

import math

import numpy as np
import pytest

from buggy_rl.visual.film import camera
from tests.visual.film.tracks import circle, straight

ASPECT = 4 / 3


def turned(track, angle):
    """The same track in a world that is turned to the left."""
    cos, sin = math.cos(angle), math.sin(angle)
    pose = track.pose.copy()
    pose[:, :2] = pose[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    pose[:, 2] += angle
    return type(track)(track.name, track.time, pose, track.velocity, track.action)


def test_chase_looks_along_the_car_and_lags_behind_in_a_bend():
    assert camera.chase_view([straight()], 2.0, ASPECT).azimuth == pytest.approx(0.0)
    track = circle(speed=2.0)  # yaw rate 1 rad/s
    azimuth = camera.chase_view([track], 3.0, ASPECT).azimuth
    assert azimuth == pytest.approx(3.0 - camera.SETTLING, abs=0.02)  # a ramp lags by the constant


def test_turning_the_world_turns_the_view():
    before = camera.chase_view([circle()], 1.5, ASPECT)
    after = camera.chase_view([turned(circle(), 0.7)], 1.5, ASPECT)
    assert after.azimuth - before.azimuth == pytest.approx(0.7)
    assert after.distance == pytest.approx(before.distance)
    assert math.hypot(after.x, after.y) == pytest.approx(math.hypot(before.x, before.y))


def test_a_ghost_that_leaps_back_does_not_make_the_camera_leap():
    ghost = straight(name="ghost")
    ghost.pose[200:, 1] += 1.0  # 1 m aside from one row to the next
    distances = [
        camera.chase_view([straight(), ghost], t, ASPECT).distance for t in (1.99, 2.0, 3.5)
    ]
    assert distances[1] - distances[0] < 0.06
    assert distances[2] - distances[0] > 0.8


@pytest.mark.parametrize("name", ["chase", "top", "fixed"])
def test_what_is_near_the_car_is_in_the_picture_from_above(name):
    from buggy_rl.visual.film.drawing import Map

    track = circle()
    view = camera.CAMERAS[name]([track], 2.0, ASPECT)
    (x, y) = Map(view, (640, 480))(track.pose[track.row(2.0)][None, :2])[0]
    assert 0 < x < 640
    assert 0 < y < 480


def test_the_fixed_camera_stands_still_and_holds_everything():
    from buggy_rl.visual.film.drawing import Map

    track = circle(seconds=12.0)
    first, last = (camera.fixed([track], time, ASPECT) for time in (0.0, 11.0))
    assert first == last
    seen = Map(first, (640, 480))(track.pose[:, :2])
    assert (seen > 0).all()
    assert (seen < [640, 480]).all()
    near = camera.top([track], 0.0, ASPECT)  # which shows but a part of it
    assert not (Map(near, (640, 480))(track.pose[:, :2]) < [640, 480]).all()


def test_the_camera_draws_back_for_the_farthest_ghost():
    near, far = straight(y=0.2, name="near"), straight(y=1.2, name="far")
    one, two = (
        camera.chase_view(tracks, 2.0, ASPECT).distance
        for tracks in ([straight(), near], [straight(), near, far])
    )
    assert two == pytest.approx(one + 0.9 * 1.0, abs=0.01)


@pytest.mark.parametrize("y", [0.3, 1.5, -4.0])
def test_together_all_cars_are_within_the_picture(y):
    tracks = [straight(), straight(y=y, name="near"), straight(speed=0.5, name="behind")]
    view = camera.together(tracks, 3.0, ASPECT)
    reach = view.distance * math.tan(camera.FIELD / 2)
    for x_, y_ in [(3.0, 0.0), (3.0, y), (1.5, 0.0)]:
        assert abs(x_ - view.x) < ASPECT * reach
        assert abs(y_ - view.y) * math.sin(-view.elevation) < reach
    assert view.distance < 1.9 + 2.2 * max(1.5, abs(y))
