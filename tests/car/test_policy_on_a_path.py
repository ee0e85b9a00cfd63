"""An exported policy where the car stands, driven by the runtime's driver."""

import math

import numpy as np
import pytest

from buggy_rl.car.interfaces import Reading
from buggy_rl.car.path import Path, path_lines
from buggy_rl.car.policy import PathDriver, Policy, make_path_driver
from tests.car.runner import write_policy

BEND = [(0.2 * i, 0.02 * i * i) for i in range(11)]


@pytest.fixture
def files(tmp_path):
    """An exported policy that steers by what it sees, and its path."""
    rng = np.random.default_rng(0)
    layers = [(0.3 * rng.normal(size=(2, 7)), np.zeros(2))]
    root = write_policy(tmp_path / "policy", layers, commands=[{"name": "last_action"}])
    (tmp_path / "bend.csv").write_text("\n".join(path_lines(Path(BEND, False))) + "\n")
    return root, str(tmp_path / "bend.csv")


def commands(policy, path, poses):
    policy.reset(path)
    return np.array([policy.step(pose, (1.0, 0.1, 0.3)) for pose in poses])


def test_moving_car_and_path_together_changes_no_command(files):
    policy = Policy.load(files[0])
    poses = [(0.05 * i, 0.01 * i, 0.02 * i) for i in range(30)]
    here = commands(policy, Path(BEND, False), poses)
    start = (2.0, -1.0, 2.5)
    cos, sin = math.cos(start[2]), math.sin(start[2])
    moved = [
        (start[0] + cos * x - sin * y, start[1] + sin * x + cos * y, start[2] + yaw)
        for x, y, yaw in poses
    ]
    there = commands(policy, Path(BEND, False).placed(start), moved)
    assert np.ptp(here[:, 1]) > 0.05
    np.testing.assert_allclose(there, here, atol=1e-5)


def test_a_placed_course_begins_where_the_car_is_armed(files):
    root, path = files
    expected = Policy.load(root)
    expected.reset(Path(BEND, False))
    driver = make_path_driver({"kind": "exported", "file": root, "path": path, "placed": True})
    armed = Reading(0.0, (3.0, 1.0, math.pi), (0.0, 0.0, 0.0))
    driver.begin(armed)
    asked = driver.step(armed)
    assert asked == pytest.approx(expected.step((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), abs=1e-5)
    assert driver.ended == ""


def test_the_loop_must_have_the_control_period_of_the_policy(files):
    root, path = files
    driver = make_path_driver({"kind": "exported", "file": root, "path": path})
    driver.refuse_other_than(0.01)
    with pytest.raises(ValueError, match=r"car\.period=0\.02 s, but the policy was made for 0\.01"):
        driver.refuse_other_than(0.02)


def test_the_driver_passes_on_what_acted(files):
    root, path = files
    driver = make_path_driver({"kind": "exported", "file": root, "path": path})
    assert isinstance(driver, PathDriver)
    reading = Reading(0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    driver.begin(reading)
    driver.step(reading)
    driver.acted((-0.5, 0.25))
    (memory,) = driver.policy._commands
    assert memory.now == (-0.5, 0.25)
