"""Rows of several sources in one table, and commands written only when they change."""

import numpy as np
import pandas as pd
import pytest

from buggy_rl.recordings import RecordingError, load_recording
from buggy_rl.recordings.loading import telling

POSE = ["x", "y", "yaw"]
COMMANDS = ["throttle", "steering"]


def joined(frame, late=0.004, every=2):
    """An outer join: poses in their rows, every second command `late` [s] after, in its own."""
    commands = frame.iloc[::every][["t", *COMMANDS]].assign(t=lambda f: f.t + late)
    poses = frame.drop(columns=COMMANDS)
    return pd.concat([poses, commands])


@pytest.mark.parametrize("sort", [True, False], ids=["by time", "one below the other"])
def test_rows_of_two_sources_are_merged_by_time(sort, make_drive, write):
    frame = make_drive(seconds=8, noise=2e-4)
    table = joined(frame)
    recording = load_recording(write(table.sort_values("t") if sort else table))
    (note,) = [n for n in recording.notes if "merged by time onto the rows of the position" in n]
    assert "throttle, steering in 33%" in note
    assert recording.duration == pytest.approx(8, abs=0.02)
    # Row k is at t = k / 100; the command before it is that of row 2 floor((k - 1) / 2).
    row = np.round(recording.data["t"][:, 0].numpy() * 100).astype(int)
    expected = frame[COMMANDS].to_numpy()[(row - 1) // 2 * 2]
    assert np.allclose(recording.data["action"], expected, atol=1e-6)
    assert np.allclose(recording.data["velocity"][:, 0], frame.vx.to_numpy()[row], atol=1e-6)


def test_three_sources_are_interpolated_and_no_yaw_across_its_wrap(make_drive, write):
    frame = make_drive(seconds=12, agility=4.0)
    assert (frame.yaw.diff().abs() > 6).any()  # it wraps
    heading = frame[["t", "yaw"]].assign(t=frame.t + 0.003)
    table = pd.concat([frame[["t", "x", "y"]], heading, frame[["t", *COMMANDS]]]).sort_values("t")
    recording = load_recording(write(table))
    assert recording.duration > 11.9
    truth = np.interp(recording.data["t"][:, 0], heading.t, np.unwrap(heading.yaw))
    off = np.remainder(recording.data["pose"][:, 2].numpy() - truth + np.pi, 2 * np.pi) - np.pi
    assert np.abs(off).max() < 1e-3


def on_change(frame):
    coarse = frame.assign(**{c: frame[c].round(1) for c in COMMANDS})
    same = (coarse[COMMANDS].diff() == 0).all(axis=1)
    return coarse, coarse.assign(**{c: coarse[c].mask(same) for c in COMMANDS})


def test_commands_written_on_change_are_held_and_said(make_drive, write):
    coarse, table = on_change(make_drive(seconds=8, noise=2e-4))
    assert table.throttle.isna().mean() > 0.5
    recording = load_recording(write(table))
    assert len(recording) == len(coarse)
    assert np.allclose(recording.data["action"], coarse[COMMANDS], atol=1e-6)
    told = telling(recording.notes)
    assert [n for n in told if "commands held until their next value" in n]
    assert [n for n in told if "held for up to" in n]


def test_commands_lost_for_a_while_are_refused_and_not_held(make_drive, write):
    frame = make_drive(seconds=8, noise=2e-4)
    frame.loc[300:500, COMMANDS] = np.nan
    with pytest.raises(RecordingError, match=r"row 300, column throttle: no value \(NaN\)"):
        load_recording(write(frame))


def test_a_pose_lost_for_a_while_names_the_limit_that_cuts_it(make_drive, write, tmp_path):
    frame = make_drive(seconds=8, noise=2e-4)
    frame.loc[300:500, POSE] = np.nan
    with pytest.raises(RecordingError, match=r"limits: \{missing_share: 0.26\}"):
        load_recording(write(frame))
    (tmp_path / "map.yaml").write_text("limits: {missing_share: 0.26}\n")
    recording = load_recording(write(frame), tmp_path / "map.yaml")
    assert recording.duration == pytest.approx(6, abs=0.1)


def test_commands_that_stop_while_the_car_moves_are_told(make_drive, write):
    frame = make_drive(noise=2e-4)
    frame.loc[800:1200, COMMANDS] = frame.loc[800, COMMANDS].to_numpy()
    told = telling(load_recording(write(frame)).notes)
    assert [n for n in told if n.startswith("rows 800-1200, column throttle: the commands stop")]
    assert not telling(load_recording(write(make_drive(noise=2e-4))).notes)
