"""Writing is exact and all or nothing."""

import os
import stat

import pandas as pd
import pytest

from buggy_rl.recordings import load_recording, save_recording


@pytest.fixture
def recording(make_drive, write):
    frame = make_drive(rate=90, noise=2e-4).drop(columns=["vx", "vy", "yaw_rate"])
    frame.loc[600:, "x"] += 1.0  # a teleport: two segments although no row is missing
    frame["t"] += 1.7e9
    return load_recording(write(frame.drop(index=range(900, 950))))


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_what_is_written_is_read_back_to_the_last_bit(ending, recording, tmp_path):
    assert recording.data["segment"].max() == 2
    path = tmp_path / f"again{ending}"
    save_recording(recording, path)
    again = load_recording(path)
    for key in ("t", "pose", "velocity", "action", "segment"):
        assert (again.data[key] == recording.data[key]).all(), key
        assert again.data[key].dtype == recording.data[key].dtype
    assert not [note for note in again.notes if "derived" in note]


def test_only_the_columns_of_the_contract_are_written(recording, tmp_path):
    save_recording(recording, tmp_path / "again.csv")
    columns = ["t", "x", "y", "yaw", "vx", "vy", "yaw_rate", "throttle", "steering"]
    assert list(pd.read_csv(tmp_path / "again.csv").columns) == columns


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_crash_while_writing_leaves_the_old_file(ending, recording, tmp_path, monkeypatch):
    path = tmp_path / f"drive{ending}"
    path.write_text("old")
    before = set(os.listdir(tmp_path))

    def crash(self, name, **_):
        with open(name, "w") as file:
            file.write("half a l")
        raise KeyboardInterrupt

    monkeypatch.setattr(pd.DataFrame, "to_csv", crash)
    monkeypatch.setattr(pd.DataFrame, "to_parquet", crash)
    with pytest.raises(KeyboardInterrupt):
        save_recording(recording, path)
    assert path.read_text() == "old"
    assert set(os.listdir(tmp_path)) == before


def test_a_written_file_has_ordinary_permissions(recording, tmp_path):
    save_recording(recording, tmp_path / "drive.csv")
    (tmp_path / "plain").touch()
    mode = (stat.S_IMODE(os.stat(tmp_path / name).st_mode) for name in ("drive.csv", "plain"))
    assert len(set(mode)) == 1


def test_another_ending_is_refused(recording, tmp_path):
    with pytest.raises(ValueError, match=r"use \.csv or \.parquet"):
        save_recording(recording, tmp_path / "drive.txt")
