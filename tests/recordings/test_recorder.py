"""What is driven is on the disk, row by row."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from buggy_rl.core import keys
from buggy_rl.recordings import load_recordings
from buggy_rl.recordings.saving import Recorder, next_free

DRIVING = """
import sys, time
from buggy_rl.recordings.saving import Recorder
recorder, row = Recorder(sys.argv[1]), 0
while True:
    t = 0.01 * row
    recorder.write(t, (2.0 * t, 0.0, 0.0, 2.0, 0.0, 0.0, 0.1, 0.0))
    row += 1
    time.sleep(0.0005)
"""


def rows(count):
    """A car that turns to the left, float32 as the engines': [count, 8]."""
    t = 0.01 * np.arange(count)
    yaw = 0.5 * t
    x, y = 4 * np.sin(yaw), 4 * (1 - np.cos(yaw))
    steady = [np.full(count, value) for value in (2.0, 0.0, 0.5)]
    action = [-0.3 + 0.1 * np.sin(t), 0.2 * np.cos(t)]
    return np.stack([x, y, yaw, *steady, *action], 1).astype(np.float32)


def test_a_recording_read_again_is_what_was_driven(tmp_path):
    driven = rows(200)
    with Recorder(tmp_path / "drive.csv") as recorder:
        for index, values in enumerate(driven):
            recorder.write(0.01 * index, values.tolist())
    (recording,), refused = load_recordings(tmp_path / "drive.csv")
    assert not refused
    assert recording.notes == []
    for key, columns in ((keys.POSE, slice(0, 3)), (keys.VELOCITY, slice(3, 6)),
                         (keys.ACTION, slice(6, 8))):  # fmt: skip
        np.testing.assert_array_equal(recording.data[key].numpy(), driven[:, columns])


def test_a_killed_process_leaves_a_recording_that_is_read(tmp_path):
    file = tmp_path / "drive.csv"
    process = subprocess.Popen([sys.executable, "-c", DRIVING, str(file)])
    try:
        end = time.monotonic() + 600
        while not (file.exists() and file.stat().st_size > 12000):
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.02)
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    lines = len(file.read_text().splitlines()) - 1
    (recording,), refused = load_recordings(file)
    assert not refused
    assert len(recording) >= lines - 1 > 200


def test_a_drive_is_never_written_over(tmp_path):
    file = tmp_path / "lap_0.csv"
    with Recorder(file) as recorder:
        recorder.write(0.0, [0.0] * 8)
    before = file.read_text()
    with pytest.raises(ValueError, match=r"lap_0\.csv exists.*lap_1\.csv"):
        Recorder(file)
    assert file.read_text() == before


def test_a_drive_without_rows_leaves_no_file(tmp_path):
    with Recorder(tmp_path / "drive.csv"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_the_next_free_name_counts_on(tmp_path):
    (tmp_path / "lap_0.csv").touch()
    (tmp_path / "lap_1.csv").touch()
    assert next_free(tmp_path / "lap_1.csv").name == "lap_2.csv"
    assert next_free(tmp_path / "free.csv").name == "free_0.csv"


def test_another_ending_and_a_short_row_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"\.csv"):
        Recorder(tmp_path / "drive.parquet")
    with Recorder(tmp_path / "a.csv") as recorder, pytest.raises(ValueError, match="3 values"):
        recorder.write(0.0, [1.0, 2.0, 3.0])
