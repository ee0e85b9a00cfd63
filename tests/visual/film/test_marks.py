"""Geoms of path, trails, waypoints and shadows."""

import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import drawing as m
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.canvas import AHEAD, CAR, CLOSED, GHOSTS, OPEN
from buggy_rl.visual.film.director import Director
from tests.visual.film.tracks import circle, on_course, straight


def made(tracks, time):
    return m.marks(Director(tracks).shot(time), VehicleDimensions())


def of(drawn, colour, kind=None):
    """Rows of a colour, and of a kind."""
    found = (np.abs(drawn.colour[:, :3] - colour) < 1e-9).all(1)
    return found if kind is None else found & (drawn.kind == kind)


def test_waypoints_change_colour_and_go_down_when_they_are_closed():
    drawn = made([on_course()], 1.11)
    open_, closed = of(drawn, OPEN, m.CYLINDER), of(drawn, CLOSED, m.CYLINDER)
    assert drawn.position[open_, 0].min() > 1.05 > drawn.position[closed, 0].max()
    tallest = 2 * drawn.size[open_, 1].max()
    assert tallest == pytest.approx(m.PILLAR)
    # Waypoint 5 was closed 0.11 s ago, waypoint 2 long ago: one is on its way, the other down.
    at = drawn.position[:, 0]
    assert m.DISC < 2 * drawn.size[closed & np.isclose(at, 1.0), 1].max() < m.PILLAR
    assert 2 * drawn.size[closed & np.isclose(at, 0.4), 1].max() == pytest.approx(m.DISC)


def test_marks_stand_on_the_floor():
    drawn = made([on_course()], 1.11)
    pillars = drawn.kind == m.CYLINDER
    np.testing.assert_allclose(drawn.position[pillars, 2], drawn.size[pillars, 1])


def test_ribbons_follow_their_points():
    drawn = made([circle()], 2.0)
    ahead = of(drawn, AHEAD)
    radius = np.hypot(drawn.position[ahead, 0], drawn.position[ahead, 1] - 2.0)
    np.testing.assert_allclose(radius, 2.0, atol=1e-3)
    bearing = np.arctan2(drawn.position[ahead, 0], 2.0 - drawn.position[ahead, 1])
    np.testing.assert_allclose(drawn.yaw[ahead], bearing, atol=1e-3)
    length = 2 * (drawn.size[ahead, 0] - m.AHEAD_WIDTH / 8).sum()
    assert length == pytest.approx(1.5, abs=0.01)  # 1.5 s at 1 m/s


def test_each_car_has_a_trail_of_its_colour_and_a_shadow():
    alone, both = made([circle()], 2.0), made([circle(), straight(y=1.0)], 2.0)
    assert of(alone, CAR).any()
    assert not of(alone, GHOSTS[0]).any()
    np.testing.assert_allclose(both.position[of(both, GHOSTS[0]), 1], 1.0)
    shadows = [int((drawn.kind == m.ELLIPSOID).sum()) for drawn in (alone, both)]
    assert shadows[1] == 2 * shadows[0] > 0


def test_shadows_fall_away_from_the_sun():
    drawn = made([straight()], 2.0)
    shadow = drawn.position[drawn.kind == m.ELLIPSOID][2:6, :2]  # those of the wheels
    car = VehicleDimensions()
    aside = shadow - [2.0, 0.0] - wheels.places(car)
    np.testing.assert_allclose(aside, np.tile(0.6 * car.wheel_radius * np.array(m.SUN), (4, 1)))


def test_a_car_that_stands_leaves_no_trail():
    drawn = made([straight(speed=0.0)], 2.0)
    assert not of(drawn, CAR).any()
    assert not of(drawn, AHEAD).any()
