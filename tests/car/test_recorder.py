"""The recording is whole up to the last second, in order, and read by the package."""

import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from buggy_rl.car.messages import GOOD, Report
from buggy_rl.car.recorder import COLUMNS, CommandHistory, DriveRecorder, new_recording
from buggy_rl.recordings.loading import load_recording
from buggy_rl.recordings.saving import HEADER
from tests.car.motion import ORIGIN, reading, row


def write(path, rows, recorder=None):
    recorder = recorder or DriveRecorder(str(path), ORIGIN)
    for each in rows:
        recorder.put(each, math.inf)
    return recorder


def test_its_columns_begin_with_those_of_every_recording():
    assert COLUMNS[: len(HEADER)] == HEADER


def test_what_is_put_is_read_back(tmp_path):
    file = tmp_path / "drive_00.csv"
    write(file, [row(0.01 * k) for k in range(200)]).close()
    table = pd.read_csv(file)
    assert table["t"].tolist() == pytest.approx([0.01 * k for k in range(200)], abs=1e-6)
    assert table["throttle"].tolist() == pytest.approx([1e-4 * k - 1 for k in range(200)])
    assert table["command_t"][5] == pytest.approx(0.046)
    assert set(table["source"]) == {"policy"}
    assert len(load_recording(file)) == 200


@pytest.mark.parametrize(
    "bad",
    [
        row(0.5),
        row(0.995),
        row(1.0)._replace(reading=reading(math.nan)),
        row(1.0)._replace(reading=reading(ORIGIN + 9.0)),
        row(1.0, velocity=(math.nan, 0.0, 0.0)),
        row(1.0)._replace(reading=reading(ORIGIN + 1.0, pose=(math.inf, 0.0, 0.0))),
    ],
    ids=["back", "same", "stamp not a number", "future", "not a number", "infinite"],
)
def test_what_no_recording_may_have_is_left_out_and_counted(tmp_path, bad):
    recorder = DriveRecorder(str(tmp_path / "drive_00.csv"), ORIGIN)
    for k in range(200):
        recorder.put(row(0.005 * k), ORIGIN + 0.005 * k)
    recorder.put(bad, ORIGIN + 1.0)
    recorder.put(row(1.0), ORIGIN + 1.0)
    recorder.close()
    assert (recorder.rows, recorder.left_out) == (201, 1)
    assert load_recording(recorder.path).notes == []


def test_rows_reach_the_file_while_the_drive_goes_on(tmp_path):
    file = tmp_path / "drive_00.csv"
    recorder = write(file, [row(0.01 * k) for k in range(50)])
    end = time.monotonic() + 5
    while file.read_text().count("\n") < 51 and time.monotonic() < end:
        time.sleep(0.02)
    assert file.read_text().count("\n") == 51
    recorder.close()


def test_a_torn_last_line_is_dropped_with_a_note(tmp_path):
    file = tmp_path / "drive_00.csv"
    write(file, [row(0.01 * k) for k in range(200)]).close()
    file.write_text(file.read_text()[:-30])
    recording = load_recording(file)
    assert len(recording) == 199
    assert any("row 199" in note and "cut" in note for note in recording.notes)


def test_a_drive_after_a_crash_has_a_file_of_its_own(tmp_path):
    first, _ = new_recording(str(tmp_path / "drives"))
    write(first, [row(0.0)]).close()
    before = Path(first).read_text()
    second, number = new_recording(str(tmp_path / "drives"))
    write(second, [row(0.0)]).close()
    assert (os.path.basename(first), os.path.basename(second)) == ("drive_00.csv", "drive_01.csv")
    assert number == 1
    assert Path(first).read_text() == before


def test_a_recording_is_never_written_over(tmp_path):
    write(tmp_path / "drive_00.csv", [row(0.0)]).close()
    with pytest.raises(FileExistsError):
        DriveRecorder(str(tmp_path / "drive_00.csv"), ORIGIN)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_is_said_and_not_raised_in_the_loop(tmp_path):
    recorder = DriveRecorder(str(tmp_path / "drive_00.csv"), ORIGIN)
    recorder._file = Path("/dev/full").open("w")  # noqa: SIM115
    recorder.put(row(0.0), math.inf)
    recorder.close()
    assert "No space left" in recorder.error


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_is_known_within_100_ms(tmp_path):
    recorder = DriveRecorder(str(tmp_path / "drive_00.csv"), ORIGIN)
    recorder._file = Path("/dev/full").open("w")  # noqa: SIM115
    begin = time.monotonic()
    recorder.put(row(0.0), math.inf)
    while not recorder.error:
        assert time.monotonic() < begin + 5
        time.sleep(0.002)
    assert time.monotonic() - begin < 0.16
    recorder.close()


def test_a_disk_that_does_not_answer_does_not_hold_up_the_end_for_ever(tmp_path, monkeypatch):
    monkeypatch.setattr("buggy_rl.car.recorder.LONGEST_CLOSE", 0.2)
    recorder = DriveRecorder(str(tmp_path / "drive_00.csv"), ORIGIN)
    monkeypatch.setattr(recorder, "_write", lambda: time.sleep(3))
    recorder.close()
    assert "has not answered for 0.2 s" in recorder.error


def test_a_recorder_that_breaks_says_so(tmp_path, monkeypatch):
    recorder = DriveRecorder(str(tmp_path / "drive_00.csv"), ORIGIN)

    def broken():
        raise RuntimeError("broken")

    monkeypatch.setattr(recorder, "_write", broken)
    recorder.close()
    assert recorder.error.endswith("broken")


KILLED = """
import math, sys, time
from buggy_rl.car.recorder import DriveRecorder
from tests.car.motion import ORIGIN, row
recorder = DriveRecorder(sys.argv[1], ORIGIN)
begin = time.monotonic()
for k in range(10000):
    recorder.put(row(0.01 * k), math.inf)
    print(k, flush=True)
    time.sleep(max(0.0, begin + 0.01 * k - time.monotonic()))
"""


def test_a_killed_process_loses_at_most_a_second(tmp_path):
    file = tmp_path / "drive_00.csv"
    command = [sys.executable, "-c", KILLED, str(file)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    for _ in range(180):  # 1.8 s
        put = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert put - len(load_recording(file)) < 100


def report(stamp, throttle, taken=1):
    return Report(1, stamp, throttle, 0.0, taken, GOOD)


def test_the_command_of_a_time_is_the_last_one_taken_at_or_before_it():
    history = CommandHistory()
    for k in range(10):
        history.add(report(1.0 + 0.01 * k, 0.1 * k))
    assert history.at(1.03).throttle == pytest.approx(0.3)
    assert history.at(1.0399).throttle == pytest.approx(0.3)
    assert history.at(9.0).throttle == pytest.approx(0.9)
    assert history.at(0.5)[1:] == (-1.0, 0.0)


def test_a_refused_command_never_acted():
    history = CommandHistory()
    history.add(report(1.0, 0.5))
    history.add(report(1.1, 0.7, taken=0))
    assert history.at(1.2).throttle == 0.5
