import numpy as np
import pytest

from buggy_rl.viz.film.cameras import FIELD, followed, views

POSES = np.stack([np.linspace(0, 4, 50), np.zeros(50), np.linspace(0, 1.0, 50)], -1)


def test_the_chase_camera_looks_at_the_car_and_turns_after_it():
    found = views("chase", POSES, [POSES[:, :2]], 25, 4 / 3)
    assert [v.lookat[0] for v in found] == pytest.approx(list(POSES[:, 0]))
    azimuth = np.array([v.azimuth for v in found])
    assert azimuth[0] == 0.0
    assert (np.diff(azimuth) > 0).all()
    assert azimuth[-1] < np.degrees(1.0)  # behind the car's own turn


def test_a_top_camera_stands_still_and_sees_all_there_is():
    points = np.array([[-3.0, -1.0], [5.0, 7.0], [0.0, 2.0]])
    found = views("top", POSES, [POSES[:, :2], points], 25, 4 / 3)
    assert len(set(found)) == 1
    half = found[0].distance * np.tan(np.radians(FIELD / 2))
    reach = np.abs(points - found[0].lookat[:2])
    assert (reach[:, 1] <= half).all()
    assert (reach[:, 0] <= half * 4 / 3).all()


def test_a_turn_of_more_than_half_a_circle_is_followed_all_the_way():
    turn = np.linspace(0, 12, 500)
    assert followed(turn, 5)[-1] == pytest.approx(12 - 5 * 12 / 499, abs=0.05)
    assert followed(turn, 0) == pytest.approx(turn)


def test_an_unknown_camera_is_refused():
    with pytest.raises(ValueError, match="no camera 'drone'; available: chase, top, fixed"):
        views("drone", POSES, [POSES[:, :2]], 25, 1.0)  # type: ignore[arg-type]
