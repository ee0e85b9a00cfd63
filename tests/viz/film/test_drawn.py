import numpy as np
import pytest

from buggy_rl.viz.film.cameras import View
from buggy_rl.viz.film.colours import CAR, CLOSED, GHOST, OPEN
from buggy_rl.viz.film.drawn import FLOOR, Drawn
from buggy_rl.viz.film.inset import with_inset
from buggy_rl.viz.film.shot import Shot
from buggy_rl.viz.film.track import Row

SIZE = (320, 240)
VIEW = View((0.0, 0.0, 0.0), 2.0, 90.0, -90.0)


def row(x: float, y: float, **more) -> Row:
    return Row((x, y, 0.0), 2.0, 0.5, -0.5, 0.1, 0.0, 1.0, **more)


def pixels_of(frame: np.ndarray, colour) -> np.ndarray:
    """Places [N, 2] (column, row) whose colour is nearly that."""
    near = np.abs(frame / 255.0 - np.array(colour)).max(-1) < 0.06
    return np.argwhere(near)[:, ::-1]


def shot(*rows: Row, waypoints=None) -> Shot:
    trails = [np.array([r.pose[:2]]) for r in rows]
    return Shot(["car", "ghost"][: len(rows)], rows, trails, waypoints)


def test_a_car_is_drawn_where_it_is_x_to_the_right_and_y_upwards():
    frame = Drawn([1.0], SIZE).frame(shot(row(0.5, 0.3)), VIEW)
    assert frame.shape == (240, 320, 3)
    column, line = pixels_of(frame, CAR).mean(0)
    assert column > 160 + 20
    assert line < 120 - 20


def test_without_a_car_there_is_only_floor_where_it_would_be():
    frame = Drawn([1.0], SIZE).frame(shot(row(50.0, 0.0)), VIEW)
    assert len(pixels_of(frame, CAR)) == 0
    assert len(pixels_of(frame, FLOOR)) > 0.8 * 320 * 240


def test_a_ghost_is_paler_than_the_car_beside_it():
    solid = Drawn([1.0, 1.0], SIZE).frame(shot(row(0, 0.5), row(0, -0.5)), VIEW)
    faint = Drawn([1.0, 0.3], SIZE).frame(shot(row(0, 0.5), row(0, -0.5)), VIEW)
    assert len(pixels_of(solid, GHOST)) > 20
    assert len(pixels_of(faint, GHOST)) == 0
    assert (faint[:120] == solid[:120]).all()


def test_waypoints_turn_as_they_are_closed():
    waypoints = np.array([[-1.0, 0.6], [-0.5, 0.6], [0.0, 0.6], [0.5, 0.6]])
    counts = []
    for closed in (0, 3):
        frame = Drawn([1.0], SIZE).frame(
            shot(row(0, -0.6, closed=closed), waypoints=waypoints), VIEW
        )
        counts.append((len(pixels_of(frame, OPEN)), len(pixels_of(frame, CLOSED))))
    (before_open, before_closed), (after_open, after_closed) = counts
    assert before_open > 10
    assert before_closed == 0
    assert after_open == 0
    assert after_closed > 10


@pytest.mark.parametrize("size", [(320, 240), (640, 480), (1280, 720)])
def test_the_inset_grows_with_the_frame_and_leaves_its_middle_alone(size):
    width, height = size
    frame = np.full((height, width, 3), 128, np.uint8)
    shown = with_inset(frame, shot(row(0, 0)), "a title")
    changed = np.argwhere((shown != frame).any(-1))
    assert changed[:, 0].max() > 0.9 * height
    middle = shown[int(0.4 * height) : int(0.6 * height), int(0.6 * width) :]
    assert (middle == 128).all()
    assert (frame == 128).all()
