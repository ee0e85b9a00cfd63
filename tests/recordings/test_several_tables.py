"""A drive in several tables, each with its own stamps, is read as one recording."""

import numpy as np
import pytest

from buggy_rl.recordings import RecordingError, load_recording, load_recordings

EPOCH = 1_650_000_000  # [s] of the first stamp
MAP = """
tables:
  - {file: pose.csv, time: {s: s, ns: ns}}
  - {file: command.csv, time: {s: s, ns: ns}}
  - {file: wheels.csv, time: {ms: ms}}
names: {x: pose.x, y: pose.y, yaw: pose.yaw, vx: wheels.vx, vy: wheels.vy,
        throttle: command.throttle, steering: command.steering}
time_from_first: true
"""


def stamped(frame, at, names):
    """Rows of a table at the row numbers `at`, with stamps in seconds and nanoseconds."""
    rows = frame.iloc[at]
    seconds = np.floor(rows.t)
    nanoseconds = np.round((rows.t - seconds) * 1e9).astype(int)
    return rows[names].assign(s=(EPOCH + seconds).astype(int), ns=nanoseconds)


@pytest.fixture
def folder(tmp_path, make_drive):
    """A pose at 100 Hz, commands at 50 Hz between its rows, wheel speeds at 40 Hz."""
    fine = make_drive(seconds=8.0, rate=200.0)
    drive = tmp_path / "drives" / "first"
    drive.mkdir(parents=True)
    stamped(fine, slice(0, None, 2), ["x", "y", "yaw"]).to_csv(drive / "pose.csv", index=False)
    commands = stamped(fine, slice(1, None, 4), ["throttle", "steering"])
    commands.to_csv(drive / "command.csv", index=False)
    wheels = fine.iloc[::5][["vx", "vy"]].assign(ms=1000 * (EPOCH + fine.t.iloc[::5]))
    wheels.to_csv(drive / "wheels.csv", index=False)
    (tmp_path / "map.yaml").write_text(MAP)
    return tmp_path


def rewrite(file, change):
    import pandas as pd

    change(pd.read_csv(file)).to_csv(file, index=False)


def test_a_folder_of_tables_is_one_recording_named_after_the_folder(folder, make_drive):
    (recording,), refusals = load_recordings(folder / "drives", folder / "map.yaml")
    assert refusals == []
    assert recording.name == "first"
    truth = make_drive(seconds=8.0, rate=200.0)
    at = np.round(recording.data["t"][:, 0].numpy() + 0.01, 4)  # the first has no command yet
    row = np.round(at * 200).astype(int)
    assert recording.duration == pytest.approx(7.9, abs=0.1)
    pose, velocity = recording.data["pose"].numpy(), recording.data["velocity"].numpy()
    assert np.abs(pose[:, 0] - truth.x.to_numpy()[row]).max() < 1e-5
    assert np.abs(velocity[:, 0] - truth.vx.to_numpy()[row]).max() < 2e-3  # linear over 25 ms
    # The last command stamped at or before: at 200 Hz rows 1, 5, 9, ...
    last = (row - 1) // 4 * 4 + 1
    steering = recording.data["action"][:, 1].numpy()
    assert np.allclose(steering, truth.steering.to_numpy()[last], atol=1e-6)


def test_a_hole_in_the_commands_is_a_gap_and_noted(folder):
    file = folder / "drives" / "first" / "command.csv"
    rewrite(file, lambda f: f.drop(index=range(150, 200)))  # 3 to 4 s
    recording = load_recording(file.parent, folder / "map.yaml")
    assert [note for note in recording.notes if "no value of another within 0.1 s: cut" in note]
    assert recording.data["segment"].max() == 1
    assert recording.duration == pytest.approx(7.0, abs=0.15)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.drop(columns="steering"), "command.csv.*column steering: missing; available"),
        (lambda f: f.drop(columns="ns"), "command.csv.*column ns: missing; available"),
        (lambda f: f.iloc[[1, 0, *range(2, len(f))]], "command.csv, row 1, column s, ns: time"),
        (lambda f: f.assign(s=f.s + 3600), "no row has all of the other tables within 0.1 s"),
    ],
    ids=["column", "stamp", "order", "clock"],
)
def test_a_fault_in_one_table_is_refused_by_its_file(folder, change, words):
    file = folder / "drives" / "first" / "command.csv"
    rewrite(file, change)
    with pytest.raises(RecordingError, match=words):
        load_recording(file.parent, folder / "map.yaml")


def test_a_missing_table_is_named_with_those_that_are_there(folder):
    (folder / "drives" / "first" / "wheels.csv").unlink()
    (_, refusals) = load_recordings(folder / "drives", folder / "map.yaml")
    assert "wheels.csv" in str(refusals[0])
    assert "available: command.csv, pose.csv" in str(refusals[0])


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("x: pose.x", "x: x", "names: x is 'x'; with several tables write file.column"),
        ("{ms: ms}", "{ms: minutes}", "tables: time of wheels.csv: unknown minutes"),
        ("time: {ms: ms}", "time: {}", "wheels.csv has no time"),
    ],
)
def test_a_wrong_map_of_tables_is_refused(folder, old, new, words):
    (folder / "map.yaml").write_text(MAP.replace(old, new))
    with pytest.raises(ValueError, match=words):
        load_recordings(folder / "drives", folder / "map.yaml")
