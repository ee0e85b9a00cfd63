"""What a shot shows, against tracks of known geometry."""

import numpy as np
import pytest

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film.director import Director
from tests.visual.film.tracks import circle, on_course, straight


def test_frames_last_as_long_as_the_drive():
    director = Director([straight(seconds=4.0)])
    assert director.times(25).tolist() == pytest.approx([k / 25 for k in range(101)])
    slow = director.times(25, playback=0.25)
    assert len(slow) == 401
    assert slow[-1] == pytest.approx(4.0)


def test_wheels_have_rolled_by_the_distance_driven():
    shot = Director([straight(speed=2.0)]).shot(1.5)
    np.testing.assert_allclose(shot.car.roll, 3.0 / VehicleDimensions().wheel_radius)
    assert shot.car.x == pytest.approx(3.0)
    assert shot.car.speed == 2.0


def test_the_steering_angle_is_that_of_the_command():
    assert Director([circle()], full_lock=0.4).shot(1.0).car.steering_angle == pytest.approx(0.2)


def test_the_path_ahead_begins_at_the_car_and_the_trail_ends_there():
    shot = Director([circle()]).shot(2.0)
    here = np.array([shot.car.x, shot.car.y])
    np.testing.assert_allclose(shot.ahead[0], here, atol=1e-9)
    np.testing.assert_allclose(shot.car.trail[-1], here, atol=1e-9)
    radius = np.hypot(shot.ahead[:, 0], shot.ahead[:, 1] - 2.0)
    np.testing.assert_allclose(radius, 2.0)
    assert np.hypot(*np.diff(shot.ahead, axis=0).T).max() < 0.06


def test_waypoints_close_one_after_the_other():
    shot = Director([on_course()]).shot(1.11)
    x, age = shot.waypoints[:, 0], shot.closed_for
    assert (age[x < 1.05] >= 0).all()  # waypoints 1 to 5, closed at 0.2 k s
    assert (age[x > 1.05] < 0).all()
    # Waypoint 5, at 1 m, was closed at 1.0 s.
    assert age[np.isclose(x, 1.0)][0] == pytest.approx(0.11)
    before = Director([on_course()]).shot(0.99)
    assert before.closed_for[np.isclose(before.waypoints[:, 0], 1.0)][0] < 0


def test_the_course_is_shown_from_the_waypoint_behind_the_car():
    shot = Director([on_course()]).shot(1.11)
    assert shot.ahead[0].tolist() == pytest.approx([1.0, 0.0])
    assert shot.ahead[-1, 0] == pytest.approx(3.8)
    np.testing.assert_allclose(shot.ahead[:, 1], 0.0)


def test_a_spline_through_a_circle_stays_on_it():
    from buggy_rl.visual.film.director import _curve

    angle = np.linspace(0, 3, 16)  # 0.2 m apart on 1 m
    points = np.stack([np.cos(angle), np.sin(angle)], -1)
    curve = _curve(points)
    assert np.abs(np.hypot(*curve.T) - 1)[4:-4].max() < 2e-4
    chords = (points[1:] + points[:-1]) / 2  # straight pieces leave it by far more
    assert np.abs(np.hypot(*chords.T) - 1).max() > 2e-3


def test_a_trail_begins_anew_where_a_simulation_was_restarted():
    again = straight(name="ghost", y=1.0, restarts=np.array([1.0, 2.0]))
    shot = Director([straight(), again]).shot(2.5)
    assert shot.ghosts
    assert shot.ghosts[0].trail[0, 0] == pytest.approx(2.0)
    assert shot.car.trail[0, 0] == pytest.approx(0.0)


def test_a_ghost_whose_track_has_ended_stands():
    short = straight(seconds=1.0, name="ghost")
    ghost = Director([straight(), short]).shot(3.0).ghosts[0]
    assert ghost.x == pytest.approx(1.0)


def test_a_moment_is_within_the_film():
    director = Director([straight(seconds=4.0)])
    assert director.moment(-1.0) == pytest.approx(2.0)
    assert director.moment(1.0) == 1.0
    with pytest.raises(ValueError, match=r"moment=5 s: the film ends at 4\.00 s"):
        director.moment(5.0)


def test_an_unknown_camera_and_a_fourth_car_are_refused():
    with pytest.raises(ValueError, match=r"camera='side'.*chase, top, fixed"):
        Director([straight()], camera="side")
    with pytest.raises(ValueError, match=r"4 tracks.*at most 2 ghosts"):
        Director([straight()] * 4)
