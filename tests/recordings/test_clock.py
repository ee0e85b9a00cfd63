"""Clocks that were set, stamps too coarse or twice, and rows without stamps."""

import numpy as np
import pandas as pd
import pytest

from buggy_rl.recordings import ColumnMap, RecordingError, load_recording
from buggy_rl.recordings.loading import telling
from buggy_rl.recordings.stamps import unwound
from tests.recordings.test_readers import npy_folder  # noqa: F401  (a fixture)

NOW = 1_700_000_000.0  # [s] since 1970


@pytest.fixture
def frame(make_drive):
    return make_drive(seconds=8.0, noise=2e-4)


def test_a_clock_that_jumps_from_1970_makes_two_segments_of_what_was_driven(frame, write):
    t = frame.t.where(frame.t < 3, frame.t + NOW)
    recording = load_recording(write(frame.assign(t=t)))
    seconds = recording.data["t"][:, 0]
    assert float(seconds[-1] - seconds[0]) == pytest.approx(8.0, abs=0.02)
    assert seconds[-1] == pytest.approx(NOW + 7.99, abs=1e-3)
    assert recording.data["segment"].max() == 1
    assert (
        "row 300, column t: the clock was set forward by 1700000000 s"
        in telling(recording.notes)[0]
    )


@pytest.mark.parametrize("back", [2.5, 0.05])
@pytest.mark.parametrize("jitter", [0.0, 0.3])
def test_a_clock_set_back_makes_two_segments(back, jitter, make_drive, write):
    frame = make_drive(seconds=8.0, noise=2e-4, jitter=jitter)
    t = frame.t.where(frame.t < 3, frame.t - back)
    recording = load_recording(write(frame.assign(t=t)))
    assert recording.data["segment"].max() == 1
    assert recording.duration == pytest.approx(8.0, abs=0.05)
    assert [n for n in telling(recording.notes) if "the clock was set back by" in n]


def test_unwound_stamps_are_those_of_a_clock_that_was_never_set():
    t = np.arange(100) * 0.5
    assert unwound(t) == (pytest.approx(t), [])
    back, (jump,) = unwound(np.where(t < 20, t, t - 7))
    assert back == pytest.approx(t)
    assert jump == (40, pytest.approx(-7))
    far, (jump,) = unwound(np.where(t < 20, t, t + 1e9))  # since 1970: the last clock is right
    assert far == pytest.approx(t + 1e9)
    misplaced = t.copy()
    misplaced[50] = 3.0
    assert unwound(misplaced)[1] == []
    shuffled = np.random.default_rng(0).permutation(t)
    assert unwound(shuffled)[1] == []


def test_rows_in_another_order_are_refused_with_what_sorts_them(frame, write):
    order = np.arange(len(frame)).reshape(-1, 2)[:, ::-1].ravel()  # 1 0 3 2 ...
    with pytest.raises(RecordingError, match="sort the table"):
        load_recording(write(frame.iloc[order]))
    assert load_recording(write(frame.iloc[order].sort_values("t"))).duration > 7.9


def test_stamps_in_whole_seconds_name_the_rate_that_reads_them(frame, write, tmp_path):
    path = write(frame.assign(t=np.floor(frame.t) + NOW))
    with pytest.raises(RecordingError, match=r"steps of 1 s, 99% .* state rate: 100 in a column"):
        load_recording(path)
    (tmp_path / "map.yaml").write_text("rate: 100\n")
    recording = load_recording(path, tmp_path / "map.yaml")
    assert recording.duration == pytest.approx(8.0, abs=0.02)


def test_a_table_without_stamps_is_read_at_its_stated_rate(frame, write):
    recording = load_recording(write(frame.drop(columns="t")), ColumnMap(rate=100.0))
    assert recording.data["t"][:, 0].numpy() == pytest.approx(frame.t.to_numpy(), abs=1e-9)


@pytest.mark.parametrize("rate", [0.0, -5.0])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ValueError, match="rate is"):
        ColumnMap(rate=rate)


def test_arrays_without_stamps_say_so_and_how_to_state_their_rate(npy_folder):  # noqa: F811
    told = telling(load_recording(npy_folder).notes)
    assert "100 Hz assumed: if it is another, state rate in a column map" in told[0]
    for name in ("linear", "angular"):
        (npy_folder / f"{name}.npy").unlink()
    stated = load_recording(npy_folder, ColumnMap(rate=200.0))
    assert stated.duration == pytest.approx(4.0, abs=0.02)  # 8 s at 100 Hz
    assert not [n for n in stated.notes if "assumed" in n]


def test_rows_that_are_there_twice_are_left_out_and_said(frame, write):
    twice = frame.loc[np.repeat(frame.index, np.where(frame.index % 5 == 0, 2, 1))]
    recording = load_recording(write(twice))
    assert np.allclose(recording.data["velocity"][:, 0], frame.vx, atol=1e-6)
    assert [n for n in telling(recording.notes) if "stamp and motion are those of the next" in n]


def test_of_rows_with_one_stamp_the_last_command_acts(frame, write):
    twice = frame.loc[np.repeat(frame.index, np.where(frame.index == 100, 2, 1))].reset_index()
    twice.loc[100, "steering"] = 0.9  # replaced by that of row 101 at the same time
    recording = load_recording(write(twice.drop(columns="index")))
    assert np.allclose(recording.data["action"][:, 1], frame.steering, atol=1e-6)


def test_two_sources_under_the_same_stamps_are_refused(frame, write):
    other = frame.assign(x=frame.x + 0.3)
    both = pd.concat([frame, other.iloc[::10]]).sort_values("t", kind="stable")
    with pytest.raises(RecordingError, match="two sources in one column; keep the rows of one"):
        load_recording(write(both))


def test_a_clock_set_back_in_all_tables_of_a_drive_is_unwound(frame, tmp_path):
    folder = tmp_path / "drive"
    folder.mkdir()
    t = NOW + frame.t.where(frame.t < 3, frame.t - 2.5)
    frame.assign(t=t)[["t", "x", "y", "yaw"]].to_csv(folder / "pose.csv", index=False)
    frame.assign(t=t).iloc[::2][["t", "throttle", "steering"]].to_csv(
        folder / "command.csv", index=False
    )
    (tmp_path / "map.yaml").write_text(
        "tables: [{file: pose.csv, time: {t: s}}, {file: command.csv, time: {t: s}}]\n"
        "names: {x: pose.x, y: pose.y, yaw: pose.yaw, throttle: command.throttle,\n"
        "        steering: command.steering}\n"
    )
    recording = load_recording(folder, tmp_path / "map.yaml")
    assert recording.duration == pytest.approx(8.0, abs=0.05)
    assert recording.data["segment"].max() == 1
    assert [n for n in telling(recording.notes) if "pose.csv: row 300: the clock was set back" in n]
    row = np.round((recording.data["t"][:, 0].numpy() - NOW + 2.5) * 100).astype(int)
    assert np.allclose(recording.data["action"][:, 1], frame.steering[row // 2 * 2], atol=1e-6)
