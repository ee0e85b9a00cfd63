import numpy as np
import pytest

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film.track import FULL_LOCK, Track

CAR = VehicleDimensions()


def straight(seconds: float = 1.0, speed: float = 2.0, **more) -> Track:
    time = np.arange(0.0, seconds + 1e-9, 0.01)
    pose = np.stack([speed * time, 0 * time, 0 * time], -1)
    velocity = np.stack([0 * time + speed, 0 * time, 0 * time], -1)
    return Track("straight", time + 7.0, pose, velocity, np.full((len(time), 2), 0.5), **more)


def test_wheels_roll_as_far_as_the_car_drives():
    rolled = straight(1.0, 2.0).rolled(CAR)
    assert rolled[0] == 0.0
    assert rolled[-1] == pytest.approx(2.0 / CAR.wheel_radius)
    assert straight(1.0, -1.0).rolled(CAR)[-1] == pytest.approx(-1.0 / CAR.wheel_radius)


def test_rows_are_read_between_those_there_are_and_held_beyond_them():
    before, middle, beyond = straight().at(np.array([0.0, 0.505, 9.0]), CAR)
    assert before.pose == (0.0, 0.0, 0.0)
    assert middle.pose[0] == pytest.approx(1.01)
    assert beyond.pose[0] == pytest.approx(2.0)
    assert middle.wheel_angle == pytest.approx(0.5 * FULL_LOCK)
    assert (before.time, beyond.time) == (0.0, 9.0)


def test_waypoints_are_closed_when_they_are_and_not_before():
    closed = np.zeros(101)
    closed[50:] = 3
    rows = straight(closed=closed).at(np.array([0.0, 0.4999, 0.5, 1.0]), CAR)
    assert [row.closed for row in rows] == [0, 0, 3, 3]


def test_a_track_says_where_it_is_no_number():
    pose = np.zeros((10, 3))
    pose[4, 1] = np.nan
    with pytest.raises(ValueError, match=r"bad: pose is no number at 0\.04 s.*seconds=0\.0"):
        Track("bad", np.arange(10) * 0.01, pose, np.zeros((10, 3)), np.zeros((10, 2)))


def test_a_track_of_one_row_or_of_unequal_lengths_is_refused():
    with pytest.raises(ValueError, match="1 rows are no film"):
        Track("short", np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), np.zeros((1, 2)))
    with pytest.raises(ValueError, match="3 rows of velocity for 2 of time"):
        Track("odd", np.arange(2.0), np.zeros((2, 3)), np.zeros((3, 3)), np.zeros((2, 2)))
