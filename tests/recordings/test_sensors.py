"""Errors of kinds of sensors, on motions whose every number is known."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.recordings.sensors import SENSORS, sensor_columns, sensor_errors

QUIET = {"position_noise": 0.0, "yaw_noise": 0.0, "velocity_noise": 0.0, "yaw_rate_noise": 0.0}
DT = 0.01


def motion(seconds=20.0):
    """A car at 2 m/s along x whose throttle is the number of the row / 1000."""
    rows = round(seconds / DT)
    t = DT * torch.arange(rows)
    still = torch.zeros(rows)
    return TensorDict(
        {
            keys.POSE: torch.stack([2 * t, still, still], -1),
            keys.VELOCITY: torch.stack([still + 2, still, still], -1),
            keys.ACTION: torch.stack([torch.arange(rows) / 1000, still], -1),
        },
        [rows],
    )


def seen(seed=0, kind="motion_capture", **changes):
    return sensor_columns(motion(), sensor_errors(kind, {"camera": QUIET, **changes}), DT, seed)


def test_a_pose_is_that_of_its_stamp_and_a_command_the_last_one_given():
    table = seen(rate=30.0, jitter=0.1)
    assert table["x"] == pytest.approx(2 * table["t"], abs=1e-4)
    assert table["throttle"] == pytest.approx(
        np.floor(table["t"] / DT + 1e-6) / 1000, abs=1e-3 + 1e-6
    )
    step = np.diff(table["t"])
    assert step.min() > 0
    assert np.median(step) == pytest.approx(1 / 30, rel=0.05)


def test_leaps_return_and_are_as_many_and_as_far_as_asked():
    table = seen(rate=50.0, jitter=0.0, leaps=30.0, leap=0.25)
    off = np.hypot(table["x"] - 2 * table["t"], table["y"])
    leaping = off > 1e-3
    assert off[leaping] == pytest.approx(0.25, abs=1e-3)
    begins = (np.diff(leaping.astype(int)) > 0).sum()
    assert 4 <= begins <= 18  # 10 expected in 20 s, Poisson
    assert leaping.mean() < 0.05


def test_frozen_poses_repeat_bit_for_bit():
    table = seen(rate=50.0, jitter=0.0, freezes=30.0)
    same = (np.diff(table["x"]) == 0).sum()
    assert 5 <= same <= 50
    assert (np.diff(seen(rate=50.0, jitter=0.0)["x"]) > 0).all()


def test_rows_in_holes_are_missing_and_nothing_stands_in_their_place():
    table = seen(rate=50.0, jitter=0.0, holes=15.0, hole=[0.3, 0.6])
    step = np.diff(table["t"])
    holes = step[step > 0.03]
    assert len(holes) >= 1
    assert ((holes > 0.25) & (holes < 1.3)).all()  # two may touch
    assert table["x"] == pytest.approx(2 * table["t"], abs=1e-4)


def test_equal_seeds_give_equal_tables():
    one, same, other = (sensor_columns(motion(2.0), SENSORS["gps"], DT, seed) for seed in (1, 1, 2))
    assert (one["x"] == same["x"]).all()
    assert (one["x"] != other["x"]).any()


def test_an_unknown_sensor_is_refused_with_those_that_there_are():
    with pytest.raises(ValueError, match="no sensor 'sonar'; available: tracking_camera, motion"):
        sensor_errors("sonar")
    with pytest.raises(ValueError, match="rate is 0"):
        sensor_errors("gps", {"rate": 0.0})
    with pytest.raises(ValueError, match="leaps is -1"):
        sensor_errors("gps", {"leaps": -1.0})
