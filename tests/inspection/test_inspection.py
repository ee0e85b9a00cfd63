"""A folder of foreign recordings: what the raw tables hold is found, and only proposed."""

import re

import numpy as np
import pandas as pd
import pytest

from buggy_rl.inspection.clock import find_clock
from buggy_rl.inspection.folder import inspect_folder
from buggy_rl.inspection.page import inspection_page, inspection_panels
from buggy_rl.inspection.signals import find_drives
from buggy_rl.recordings import load_recordings
from tests.recordings.conftest import ideal_drive

EPOCH = 1_700_000_000


@pytest.fixture(scope="module")
def drive():
    return ideal_drive(seconds=30.0, noise=5e-4, agility=2.0)


def foreign(frame: pd.DataFrame) -> pd.DataFrame:
    """The same drive in another car's table: other names, degrees, a mirrored servo and gyro."""
    gyro = np.degrees(-frame.yaw_rate)
    return pd.DataFrame(
        {
            "stamp_ms": 1000 * (EPOCH + frame.t),
            "track_x": frame.x,
            "track_y": frame.y,
            "heading": np.degrees(frame.yaw),
            "servo": 1500 - 400 * frame.steering,
            "throttle_pwm": 1500 + 250 * (frame.throttle + 1),
            "gyro_z": gyro,
            "battery": 7.4,
        }
    )


@pytest.fixture(scope="module")
def found(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    for name in ("a", "b", "c"):
        foreign(drive).to_csv(folder / f"{name}.csv", index=False)
    return inspect_folder(folder)


def test_columns_units_and_signs_are_found_with_their_evidence(found):
    text = found.proposal
    assert "t: stamp_ms" in text
    assert "x: track_x" in text
    assert "yaw: heading" in text
    assert re.search(r"units: \{.*yaw: deg.*yaw_rate: deg/s", text)
    assert "signs: {yaw_rate: -1, gyro: -1}" in text
    assert "steering: servo" in text
    assert "throttle: throttle_pwm" in text
    assert 'steering: {right: "???", left: "???"}' in text  # what was reached is no end
    found_ends = re.search(r"right ([\d.]+), left ([\d.]+)", text)
    assert found_ends is not None
    right, left = map(float, found_ends.groups())
    assert right > 1500 > left  # more pulse is more to the right
    assert "correlation" in found.commands["steering"].evidence
    assert found.commands["steering"].sign == -1  # the servo turns the other way
    assert found.commands["steering"].delay == pytest.approx(0.1, abs=0.05)  # its lag


def test_a_position_in_millimetres_beside_a_heading_of_many_turns_is_found(drive, tmp_path):
    frame = foreign(drive)
    frame["track_x"], frame["track_y"] = 1000 * frame.track_x, 1000 * frame.track_y
    frame["heading"] = np.degrees(drive.yaw) + 3600  # ten turns on
    frame.to_csv(tmp_path / "a.csv", index=False)
    assert re.search(r"units: \{.*x: mm, y: mm, yaw: deg", inspect_folder(tmp_path).proposal)


def test_a_servo_about_another_centre_steers_to_both_sides(found):
    assert not any("hardly steered" in line for line in found.suggestions)


def test_the_proposed_map_reads_the_drives_after_its_ranges_are_edited(found, drive, tmp_path):
    text = re.sub(r"steering: \{.*\}", "steering: {left: 1100, right: 1900}", found.proposal)
    text = re.sub(r"throttle: \{.*\}", "throttle: {rest: 1500, full: 2000}", text)
    (tmp_path / "map.yaml").write_text(text)
    recordings, refusals = load_recordings(found.folder, tmp_path / "map.yaml")
    assert refusals == []
    row = np.round(recordings[0].data["t"][:, 0].numpy() * 100).astype(int)
    steering = recordings[0].data["action"][:, 1].numpy()
    assert np.allclose(steering, drive.steering.to_numpy()[row], atol=1e-3)
    rate = recordings[0].data["velocity"][:, 2].numpy()
    assert np.allclose(rate, drive.yaw_rate.to_numpy()[row], atol=0.01)


def test_several_tables_of_a_drive_are_one_drive_and_become_tables_of_the_map(drive, tmp_path):
    from buggy_rl.recordings.columns import load_columns

    for name in ("one", "two"):
        folder = tmp_path / "drives" / name
        folder.mkdir(parents=True)
        seconds = np.floor(drive.t).astype(int)
        stamp = {"s": EPOCH + seconds, "ns": np.round((drive.t - seconds) * 1e9).astype(int)}
        stamp["ns"] = stamp["ns"].clip(upper=999_999_999)
        pose = pd.DataFrame({**stamp, "x": drive.x, "y": drive.y, "yaw": drive.yaw})
        pose.to_csv(folder / "pose.csv", index=False)
        command = {**stamp, "V": 2 * (drive.throttle + 1), "delta": 0.4 * drive.steering}
        pd.DataFrame(command).to_csv(folder / "command.csv", index=False)
        wheels = {**stamp, "encoder": drive.vx, "imu_z": drive.yaw_rate}
        pd.DataFrame(wheels).to_csv(folder / "wheels.csv", index=False)
    assert [name for name, _ in find_drives(tmp_path / "drives")] == ["one", "two"]
    text = inspect_folder(tmp_path / "drives").proposal
    assert "{file: pose.csv, time: {s: s, ns: ns}}" in text
    assert "steering: command.delta" in text
    text = text.replace('right: "???", left: "???"', "right: -0.4, left: 0.4")
    (tmp_path / "map.yaml").write_text(text.replace('"???"', "4"))
    assert [table.file for table in load_columns(tmp_path / "map.yaml").tables] == [
        *("pose.csv", "command.csv", "wheels.csv"),
    ]
    assert "wheel_speed: wheels.encoder" in text
    assert "gyro: wheels.imu_z" in text


def test_a_speed_setpoint_is_told_from_a_throttle(drive):
    from buggy_rl.inspection.columns import find_throttle
    from buggy_rl.inspection.signals import STEP, DriveSignals

    t = np.arange(0, 60, STEP)
    setpoint = 2 + 1.5 * np.sign(np.sin(0.7 * t))
    speed = np.zeros_like(t)
    for i in range(1, len(t)):  # a controller with a lag of 0.3 s
        speed[i] = speed[i - 1] + STEP / 0.3 * (setpoint[i - 1] - speed[i - 1])
    known = np.ones(len(t), bool)
    signals = DriveSignals(t, known, np.zeros((len(t), 2)), speed, 0 * t, {"speed_cmd": setpoint})
    guess = find_throttle(signals, None)
    assert guess is not None
    assert guess.unit == "m/s"
    assert "speed setpoint" in guess.evidence
    pull = np.gradient(speed, STEP)
    other = DriveSignals(
        t, known, np.zeros((len(t), 2)), speed, 0 * t, {"throttle": pull / pull.max()}
    )
    guess = find_throttle(other, None)
    assert guess is not None
    assert guess.unit == ""


@pytest.mark.parametrize(("factor", "unit"), [(1, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_the_unit_of_a_clock_is_that_of_a_plausible_rate(factor, unit):
    t = np.arange(0, 10, 0.02)
    clock = find_clock({"time": factor * t, "x": np.sin(t)})
    assert clock is not None
    assert clock.columns == {"time": unit}
    assert 1 / clock.period == pytest.approx(50)


def test_gaps_and_jitter_of_a_clock_are_measured():
    random = np.random.default_rng(0)
    t = np.arange(0, 20, 0.02) + 0.002 * random.standard_normal(1000)
    t[500:] += 1.5
    clock = find_clock({"t": t})
    assert clock is not None
    assert clock.jitter == pytest.approx(0.002 * 2**0.5 / 0.02, rel=0.15)
    assert clock.gaps == pytest.approx([1.52], abs=0.02)


def test_what_is_missing_and_what_to_drive_next_is_said(tmp_path):
    slow = ideal_drive(seconds=25.0, agility=0.5).drop(columns="steering")
    slow.to_csv(tmp_path / "only.csv", index=False)
    found = inspect_folder(tmp_path)
    [line] = [text for text in found.missing if text.startswith("no column was found for steering")]
    assert "nearest comes yaw_rate, correlation +0.98" in line
    assert any("record 3 or more" in line for line in found.suggestions)
    assert any("drive circles faster" in line for line in found.suggestions)


def test_a_table_without_a_position_or_a_clock_says_so(tmp_path):
    t = np.arange(0, 5, 0.01)
    pd.DataFrame({"time": t, "a": np.sin(t)}).to_csv(tmp_path / "no_pose.csv", index=False)
    (drive,) = inspect_folder(tmp_path).drives
    assert drive.pose is None
    assert "no two columns x, y move along a heading" in drive.notes[-1]
    pd.DataFrame({"a": np.sin(9 * t)}).to_csv(tmp_path / "no_pose.csv", index=False)
    (drive,) = inspect_folder(tmp_path).drives
    assert "no column is a time stamp" in drive.notes[0]


def test_a_folder_without_recordings_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no recording below it"):
        inspect_folder(tmp_path)
    with pytest.raises(ValueError, match="no such folder"):
        inspect_folder(tmp_path / "nowhere")


def test_the_page_needs_no_other_file(found):
    text = inspection_page(found, inspection_panels(found))
    assert text.count("<svg") == 3
    assert "Proposed column map" in text
    assert not re.search(r"""(src|href)=["'](?!#|data:)""", text)
    for name in ("a", "b", "c"):
        assert f"<th>{name}</th>" in text


def test_dart_is_recognised(dart_folder):
    found = inspect_folder(dart_folder, most=6)
    assert found.commands["steering"].column == "steering"
    assert found.commands["steering"].sign == 1
    assert found.commands["throttle"].column == "throttle"
    assert 't: "vicon time"' in found.proposal
    assert 'yaw_rate: "W (IMU)"' in found.proposal


def test_frictionmaps_is_recognised_with_the_gyros_true_unit(frictionmaps_folder):
    found = inspect_folder(frictionmaps_folder)
    assert [d.name for d in found.drives] == ["DS1", "DS2", "DS3", "DS4", "DS5"]
    assert found.commands["throttle"].column == "commandData.V"
    assert found.commands["throttle"].unit == "m/s"
    assert found.commands["steering"].column == "commandData.delta"
    assert (
        "units: {yaw_rate: deg/s, gyro: deg/s}" in found.proposal
    )  # their documentation says otherwise
    assert "accelerations there are in g" in found.proposal


def test_the_script_writes_a_page_a_picture_and_a_proposal(
    found, repository, tmp_path, monkeypatch
):
    import runpy

    words = ["inspect_recordings.py", found.folder, "most=2", f"output={tmp_path / 'out'}"]
    monkeypatch.setattr("sys.argv", words)
    runpy.run_path(str(repository / "scripts" / "inspect_recordings.py"), run_name="__main__")
    assert (tmp_path / "out" / "inspection.png").read_bytes().startswith(b"\x89PNG")
    assert "guesses from the data of 2 drives" in (tmp_path / "out" / "columns.yaml").read_text()
    assert "<svg" in (tmp_path / "out" / "inspection.html").read_text()
    monkeypatch.setattr("sys.argv", ["inspect_recordings.py"])
    with pytest.raises(SystemExit, match="name one folder of recordings"):
        runpy.run_path(str(repository / "scripts" / "inspect_recordings.py"), run_name="__main__")
