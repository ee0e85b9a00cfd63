"""A shot as viser's scene."""

from dataclasses import replace

import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film.canvas import CLOSED, OPEN, pixel
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.shot import View
from buggy_rl.visual.film.wheels import PLACES
from buggy_rl.visual.viewer.film_player import FilmPlayer, instruments
from buggy_rl.visual.viewer.live_window import LiveTrack
from buggy_rl.visual.viewer.stage import BODIES, POSTS, eye, parts, pieces, posts, turn_quaternion
from tests.visual.film.tracks import on_course, straight
from tests.visual.viewer.client import reachable


def test_the_car_has_its_dimensions_and_stands_on_its_wheels():
    car = parts(VehicleDimensions())
    assert tuple(car) == BODIES
    corners = np.concatenate([part.vertices for part in car[""]])
    length, width, _ = np.ptp(corners, axis=0)
    assert length == pytest.approx(0.273, abs=0.03)
    assert 0.1 < width < 0.2
    for place in PLACES:
        tyre = np.concatenate([part.vertices for part in car[f"_{place}"]])
        assert np.abs(tyre[:, [0, 2]]).max() == pytest.approx(0.0325, abs=0.001)


def test_only_the_ghost_is_translucent():
    for name, opaque in (("car", True), ("ghost", False), ("ghost_2", False)):
        alphas = {part.alpha for body in parts(VehicleDimensions(), name).values() for part in body}
        assert all((alpha == 1) == opaque for alpha in alphas)


def test_a_turn_about_z_is_to_the_left():
    assert turn_quaternion(2, np.pi / 2) == pytest.approx((np.sqrt(0.5), 0, 0, np.sqrt(0.5)))


def test_closed_waypoints_are_green_and_down_and_the_rest_waits_below():
    waypoints = np.array([[1.0, 2.0], [3.0, 4.0]])
    position, scale, colour = posts(waypoints, np.array([5.0, -1.0]))
    assert colour[:2].tolist() == [list(pixel(CLOSED)), list(pixel(OPEN))]
    np.testing.assert_allclose(position[:2, :2], waypoints)
    assert scale[0, 2] < 0.01 < scale[1, 2]
    assert len(position) == POSTS
    assert (position[2:, 2] < 0).all()


def test_segments_join_the_points():
    segments = pieces(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]]), 0.5)
    assert segments.tolist() == [[[0, 0, 0.5], [1, 0, 0.5]], [[1, 0, 0.5], [1, 2, 0.5]]]
    assert len(pieces(np.zeros((1, 2)), 0.5)) == 0


def test_the_camera_is_behind_and_above():
    # Looks along x, 30 degrees down, from 2 m: 2 cos 30 behind and 2 sin 30 above.
    view = View(1.0, 5.0, 0.0, 2.0, 0.0, -np.pi / 6)
    assert eye(view) == pytest.approx([1 - np.sqrt(3), 5.0, 1.0])


def test_steering_to_the_left_fills_to_the_left():
    shot = Director([straight()]).shot(0.5)

    def shown(steering):
        return instruments(replace(shot, car=replace(shot.car, steering=steering)))

    assert "left:25.0%;width:25.0%" in shown(0.5)
    assert "left:50.0%;width:25.0%" in shown(-0.5)


@pytest.fixture(scope="module")
def player():
    player = FilmPlayer(Director([on_course(), straight()]))
    yield player
    player.stop()


def test_the_film_is_served_on_this_machine_only(player):
    port = int(player.url.rpartition(":")[2])
    assert reachable("127.0.0.1", port)
    assert not reachable("127.0.0.2", port)


def test_a_film_plays_pauses_and_seeks(player):
    player.speed.value = "0.5"
    player.seek.value = 0.2
    player.advance(0.4)
    assert player.seek.value == pytest.approx(0.4)
    player.playing.value = False
    player.advance(0.4)
    assert player.seek.value == pytest.approx(0.4)
    player.playing.value = True
    player.advance(2 * player.duration)  # at half speed a whole film later
    assert player.seek.value == pytest.approx(0.4, abs=1e-3)


def test_a_drive_is_shown_as_its_film_would_be_though_old_rows_are_forgotten():
    time = 0.01 * np.arange(1200)
    motion = np.zeros((1200, 8))
    motion[:, 0], motion[:, 3] = time, 1.0  # 1 m/s along x
    live = LiveTrack("car", None)
    assert live.shot("chase") is None
    for t, values in zip(time.tolist(), motion.tolist(), strict=True):
        live.add((t, tuple(values), 0))
    shot = live.shot("chase")
    assert shot is not None
    assert shot.car.x == pytest.approx(11.99)
    # omega = v / R: 11.99 s at 1 m/s on wheels of 0.0325 m.
    assert shot.car.roll == pytest.approx(np.full(4, 11.99 / 0.0325), rel=1e-6)
    with pytest.raises(ValueError, match="after one at"):
        live.add((5.0, tuple(motion[0]), 0))
