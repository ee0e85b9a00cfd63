"""Simulators under the commands of a recording, and drivers on a course."""

from functools import partial

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.policies.controllers.path_tracking import PurePursuit
from buggy_rl.recordings.recording import Recording
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.visual.film.source import course_of, driven_track, replayed

HOLD = partial(make_simulator, "hold")  # keeps its velocity for ever
KINEMATIC = partial(make_simulator, "kinematic")


def recording(count=200, vx=1.0, yaw_rate=0.5):
    """A car that turns to the left at a steady speed; every row can be told by its time."""
    time = 0.01 * torch.arange(count, dtype=torch.float64)
    yaw = (yaw_rate * time).float()
    pose = torch.stack([2 * torch.sin(yaw), 2 * (1 - torch.cos(yaw)), yaw], -1)
    velocity = torch.tensor([vx, 0.0, yaw_rate]).repeat(count, 1)
    data = {
        keys.TIME: time[:, None],
        keys.POSE: pose,
        keys.VELOCITY: velocity,
        keys.ACTION: torch.linspace(-1, 1, count)[:, None].repeat(1, 2),
        keys.SEGMENT: torch.zeros(count, dtype=torch.long),
    }
    return Recording("drive", TensorDict(data, [count]), 0.01)


def test_a_simulator_that_is_right_drives_what_was_recorded():
    track = replayed(HOLD, recording(), "hold", start=0.5)
    expected = recording().data[keys.POSE][50:].numpy()
    np.testing.assert_allclose(track.pose, expected, atol=2e-4)
    assert track.duration == pytest.approx(1.49)


def test_commands_go_to_their_own_rows():
    track = replayed(HOLD, recording(), "hold", start=0.5, seconds=0.3)
    np.testing.assert_allclose(track.action, recording().data[keys.ACTION][50:81], atol=1e-6)


def test_a_restart_goes_back_to_what_was_measured():
    wrong = recording(yaw_rate=0.5)
    wrong.data[keys.VELOCITY] = torch.tensor([1.0, 0.0, 0.0]).repeat(200, 1)  # drives straight on
    once = replayed(HOLD, wrong, "hold")
    again = replayed(HOLD, wrong, "hold", restart=0.5)
    measured = wrong.data[keys.POSE].numpy()
    assert again.restarts.tolist() == pytest.approx([0.5, 1.0, 1.5])
    for row in (0, 50, 100, 150):
        np.testing.assert_allclose(again.pose[row], measured[row], atol=1e-6)
    errors = [np.abs(track.pose[:, :2] - measured[:, :2]).max() for track in (once, again)]
    assert errors[0] > 5 * errors[1] > 0
    assert len(again.time) == len(once.time) == 200


def test_a_start_is_the_same_whatever_was_driven_before_the_warm_up():
    first = replayed(KINEMATIC, recording(), "k", start=1.0)
    other = recording()
    other.data[keys.ACTION][:60] = 0.3  # more than 0.3 s before
    np.testing.assert_array_equal(first.pose, replayed(KINEMATIC, other, "k", start=1.0).pose)


def lap():
    paths = make_paths(PathConfig(kind="lap"))
    return make_env(KINEMATIC(1), task=TaskConfig(), paths=paths)


def test_a_driver_is_followed_with_its_course():
    track = driven_track(lap(), PurePursuit(), 150, "pure pursuit")
    assert track.course is not None
    assert track.course.closed
    assert track.following[0] == 1
    assert (np.diff(track.following) >= 0).all()
    assert track.following[-1] > 3
    last = track.course.waypoints(np.array([track.following[-1] - 1]))[0]
    assert np.hypot(*(track.pose[-1, :2] - last)) < 0.4  # near the waypoint closed last


def test_a_simulator_without_a_task_has_no_course():
    assert course_of(KINEMATIC(1)) is None
    found = course_of(lap())
    assert found is not None
    assert len(found.points) > 10
