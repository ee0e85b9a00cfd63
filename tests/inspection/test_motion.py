"""Positions and headings of cars that also drive backward, and in words for east and north."""

import numpy as np
import pytest

from buggy_rl.inspection.clock import find_clock
from buggy_rl.inspection.motion import find_poses


def driven(backward=0.0, seconds=20.0):
    """On a circle of 2 m at 1 m/s, backward for a share of the time; columns of a table."""
    t = np.arange(0.0, seconds, 0.02)
    speed = np.where(t < seconds * (1 - backward), 1.0, -1.0)
    yaw = np.cumsum(speed * 0.02) / 2.0
    x, y = np.cumsum(speed * np.cos(yaw)) * 0.02, np.cumsum(speed * np.sin(yaw)) * 0.02
    return {"time": t, "x": x, "y": y, "yaw": yaw}


def renamed(columns, *names):
    return dict(zip(names, columns.values(), strict=True))


def poses(columns):
    clock = find_clock(columns)
    assert clock is not None
    return find_poses("drive", columns, clock)


def test_a_heading_that_the_car_follows_both_ways_is_found_and_the_share_backward_said():
    [found, *_] = poses(driven(backward=0.3))
    assert found.names["yaw"] == "yaw"
    assert found.backward == pytest.approx(0.3, abs=0.03)
    assert found.reverses
    assert "backward in 30% of the time" in found.evidence or "29%" in found.evidence
    [forward, *_] = poses(driven())
    assert not forward.reverses
    assert "backward" not in forward.evidence


def test_a_car_that_mostly_drives_against_its_heading_has_none():
    assert not [p for p in poses(driven(backward=0.7)) if p.names["yaw"] == "yaw" and p.sign > 0]


@pytest.mark.parametrize(
    ("east", "north"),
    [("easting", "northing"), ("utm_e", "utm_n"), ("East [m]", "North [m]"), ("pos_E", "pos_N")],
)
def test_east_and_north_are_a_position(east, north):
    [found, *_] = poses(renamed(driven(), "time", east, north, "heading"))
    assert (found.names["x"], found.names["y"]) == (east, north)
    assert found.unit == "m"
