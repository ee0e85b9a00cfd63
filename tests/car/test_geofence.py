"""Inside and outside."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from buggy_rl.car.safety import Circle, Polygon, make_geofence

NUMBER = st.floats(-5, 5)


@given(NUMBER, NUMBER)
def test_a_square_holds_what_its_bounds_do_in_either_order(x, y):
    corners = ((-1.0, -2.0), (3.0, -2.0), (3.0, 2.5), (-1.0, 2.5))
    expected = -1 < x < 3 and -2 < y < 2.5
    edge = x in (-1.0, 3.0) or y in (-2.0, 2.5)
    if not edge:
        assert Polygon(corners).holds(x, y) == Polygon(corners[::-1]).holds(x, y) == expected


def test_a_notch_is_outside():
    notched = Polygon(((0, 0), (4, 0), (4, 4), (2, 1), (0, 4)))
    assert notched.holds(0.5, 2.0)
    assert not notched.holds(2.0, 2.0)


def test_a_circle_holds_its_rim():
    assert Circle(1.0, 0.0, 2.0).holds(3.0, 0.0)
    assert not Circle(1.0, 0.0, 2.0).holds(3.001, 0.0)


def test_fences_are_made_of_plain_values():
    assert make_geofence({"circle": [1, 2, 3]}) == Circle(1.0, 2.0, 3.0)
    assert make_geofence({"polygon": [[0, 0], [1, 0], [0, 1]]}).holds(0.2, 0.2)
    assert make_geofence("none").holds(1e9, 0.0)


@pytest.mark.parametrize(
    "about",
    [
        {},
        "",
        {"circle": [0, 0]},
        {"circle": [0, 0, -1]},
        {"circle": [0, float("nan"), 1]},
        {"polygon": [[0, 0], [1, 1]]},
        {"polygon": [[0, 0], [1, 1], [2]]},
        {"square": 3},
    ],
    ids=str,
)
def test_anything_else_is_refused(about):
    with pytest.raises(ValueError, match="geofence"):
        make_geofence(about)
