"""Tracks, their checks and their sources."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.recordings.recording import Recording
from buggy_rl.visual.film.track import PathLine, Track, from_recording, from_rollout
from tests.visual.film.tracks import circle


def recording(count=100, gap=60):
    """A car whose x is the time; a gap of 1 s before row `gap`."""
    time = 5.0 + 0.01 * torch.arange(count, dtype=torch.float64)
    time[gap:] += 1.0
    segment = (torch.arange(count) >= gap).long()
    pose = torch.stack([time.float(), torch.zeros(count), torch.zeros(count)], -1)
    data = TensorDict(
        {
            keys.TIME: time[:, None],
            keys.POSE: pose,
            keys.VELOCITY: torch.ones(count, 3),
            keys.ACTION: torch.zeros(count, 2),
            keys.SEGMENT: segment,
        },
        [count],
    )
    return Recording("drive", data, 0.01)


def test_a_recording_is_shown_from_its_start_to_the_gap():
    track = from_recording(recording(), start=0.2, seconds=10.0)
    assert track.time[0] == 0.0
    assert track.pose[0, 0] == pytest.approx(5.2)
    assert track.duration == pytest.approx(0.39)  # rows 20 to 59
    assert from_recording(recording(), 0.2, 0.1).duration == pytest.approx(0.1)


@pytest.mark.parametrize(("start", "said"), [(1.0, "gap"), (7.0, "ends at 1.99"), (-1.0, "start")])
def test_a_start_outside_is_refused(start, said):
    with pytest.raises(ValueError, match=said):
        from_recording(recording(), start)


def test_between_rows_the_motion_is_linear_and_the_command_holds():
    time = np.array([0.0, 1.0, 2.0])
    pose = np.array([[0, 0, 3.0], [1, 2, -3.2], [2, 4, -3.0]])  # yaw passes pi
    action = np.array([[-1, 0], [1, 0.5], [0, 0]])
    track = Track("t", time, pose, np.zeros((3, 3)), action)
    (x, y, yaw), _, (throttle, _) = track.at(0.5)
    assert (x, y, throttle) == (0.5, 1.0, -1.0)
    assert yaw == pytest.approx(3.0 + (2 * np.pi - 6.2) / 2)
    assert track.at(1.0)[2].tolist() == [1.0, 0.5]


def broken(**changes):
    track = circle()
    columns = {n: getattr(track, n).copy() for n in ("time", "pose", "velocity", "action")}
    columns.update({name: change(columns[name]) for name, change in changes.items()})
    return Track("broken", **columns)


def nan_at(row):
    def change(column):
        column[row] = np.nan
        return column

    return change


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pose": nan_at(123)}, r"not finite at 1\.23 s.*seconds=1\.23"),
        ({"time": lambda t: t[::-1].copy()}, "increase"),
        ({"action": lambda a: a[:-1]}, "action has 400 rows, time has 401"),
    ],
)
def test_what_cannot_be_shown_is_refused_with_its_place(changes, said):
    with pytest.raises(ValueError, match=said):
        broken(**changes)


def test_a_rollout_of_an_environment_becomes_a_track():
    rows = TensorDict(
        {
            keys.POSE: torch.rand(5, 3),
            keys.VELOCITY: torch.rand(5, 3),
            keys.ACTION: torch.rand(5, 2),
        },
        [5],
    )
    track = from_rollout(rows, "mine", 0.02)
    assert track.duration == pytest.approx(0.08)
    np.testing.assert_allclose(track.velocity, rows[keys.VELOCITY].numpy())


def test_indices_go_on_over_laps_and_end_with_an_open_path():
    points = np.arange(10.0).reshape(5, 2)
    lap, open_ = PathLine(points, True), PathLine(points, False)
    assert lap.within(3, 7).tolist() == [3, 4, 5, 6]
    np.testing.assert_array_equal(lap.waypoints(np.array([6])), points[[1]])
    assert open_.within(3, 7).tolist() == [3, 4]
    assert open_.within(-2, 2).tolist() == [0, 1]
