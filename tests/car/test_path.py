"""Paths of the car: files, tables, places."""

import math

import numpy as np
import pytest

from buggy_rl.car.path import Path, load_path, path_lines

SQUARE = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]


def test_a_file_is_read_back_as_it_was_written(tmp_path):
    file = tmp_path / "course.csv"
    for closed in (False, True):
        points = np.float32(SQUARE) / 3
        file.write_text("\n".join(path_lines(Path(points, closed))) + "\n")
        read = load_path(str(file))
        assert (read.closed, read.name, len(read)) == (closed, "course", 4)
        assert np.array_equal(read.points, points)


def test_tangents_go_through_the_neighbours():
    tangents = Path(SQUARE, True).tables(1).tangents
    half = math.sqrt(0.5)
    np.testing.assert_allclose(tangents[1], [half, half], rtol=1e-6)  # from (0, 0) to (1, 1)
    np.testing.assert_allclose(tangents[4], tangents[0])  # a closed path again
    np.testing.assert_allclose(Path(SQUARE, False).tables(2).tangents[0], [1, 0])


def test_an_open_path_goes_straight_on():
    points = Path(SQUARE, False).tables(2).points
    np.testing.assert_allclose(points[4:], [(-1, 1), (-2, 1)])


def test_a_path_is_placed_where_the_car_stands():
    placed = Path(SQUARE, False).placed((2.0, 3.0, math.pi / 2))
    np.testing.assert_allclose(placed.points[:3], [(2, 3), (2, 4), (1, 4)], atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,z\n0,0\n", r"course\.csv has x, z: it needs columns x and y"),
        ("x,y\n", "no rows: it needs"),
        ("x,y\n0,0\n1,nan\n2,0\n", r"row 3: x, y are 1, nan"),
        ("x,y\n0,0\n1,left\n2,0\n", r"row 3: x, y are 1, left"),
        ("x,y\n0,0\n1\n2,0\n", r"row 3: x, y are 1, None"),
        ("x,y\n0,0\n1,0\n", r"shape \[2, 2\]: needed are \[3 or more, 2\]"),
        ("x,y\n0,0\n0,0\n1,0\n2,0\n", "repeats its neighbour at waypoint 0"),
        ("x,y\n0,0\n1,0\n0,0\n-1,0\n", "turns back at waypoint 1"),
    ],
)
def test_a_bad_file_is_refused(tmp_path, text, message):
    file = tmp_path / "course.csv"
    file.write_text(text)
    with pytest.raises(ValueError, match=message):
        load_path(str(file))


def test_a_missing_file_is_refused_with_the_remedy():
    with pytest.raises(ValueError, match=r"no path file nowhere\.csv: name a CSV"):
        load_path("nowhere.csv")
