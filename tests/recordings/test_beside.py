"""Sensors beside the tracker: read where they are, never a reason to cut or refuse."""

import numpy as np
import pandas as pd
import pytest
import torch

from buggy_rl.recordings import RecordingError, load_recording, save_recording
from buggy_rl.recordings.columns import ColumnMap


@pytest.fixture
def drive(make_drive):
    frame = make_drive()
    return frame.assign(wheel_speed=frame.vx * 1.02, gyro=frame.yaw_rate + 0.01)


def test_they_are_read_at_the_recordings_rows(drive, write):
    recording = load_recording(write(drive))
    for key, channel in (("wheel_speed", "vx"), ("gyro", "yaw_rate")):
        read, of = recording.data[key], drive[channel].to_numpy()
        assert read.shape == (len(recording), 1)
        assert read.dtype == torch.float32
        expected = of * 1.02 if key == "wheel_speed" else of + 0.01
        np.testing.assert_allclose(read[:, 0].numpy(), expected[: len(read)], atol=1e-5)


def test_a_recording_without_them_has_no_such_key(make_drive, write):
    assert not {"wheel_speed", "gyro"} & set(load_recording(write(make_drive())).data.keys())


def test_they_have_names_units_and_signs_of_their_own(drive, write):
    table = drive.assign(w=-3.6 * drive.wheel_speed, g=np.degrees(drive.gyro))
    columns = ColumnMap(
        names={"wheel_speed": "w", "gyro": "g"},
        units={"wheel_speed": "km/h", "gyro": "deg/s"},
        signs={"wheel_speed": -1},
    )
    read = load_recording(write(table.drop(columns=["wheel_speed", "gyro"])), columns).data
    plain = load_recording(write(drive)).data
    for key in ("wheel_speed", "gyro"):
        torch.testing.assert_close(read[key], plain[key])


def test_a_named_column_that_is_not_there_is_an_error(make_drive, write):
    with pytest.raises(RecordingError, match="rpm"):
        load_recording(write(make_drive()), ColumnMap(names={"wheel_speed": "rpm"}))


def test_missing_values_cut_nothing_and_stay_missing(drive, write):
    drive.loc[300:600, "gyro"] = np.nan
    drive.loc[800:801, "gyro"] = np.nan  # shorter than is bridged
    recording = load_recording(write(drive))
    assert len(recording) == len(load_recording(write(drive.drop(columns="gyro"))))
    lost = recording.data["gyro"].isnan().flatten()
    assert bool(lost[310:590].all())
    assert not bool(lost[:290].any() | lost[610:].any())


def test_they_are_written_and_read_back(drive, write, tmp_path):
    drive.loc[300:600, "gyro"] = np.nan
    recording = load_recording(write(drive))
    save_recording(recording, tmp_path / "again.csv")
    again = load_recording(tmp_path / "again.csv")
    for key in ("wheel_speed", "gyro"):
        torch.testing.assert_close(again.data[key], recording.data[key], equal_nan=True)


def test_a_slower_imu_in_a_table_of_its_own_leaves_out_no_row(drive, tmp_path):
    drive.drop(columns=["gyro", "wheel_speed"]).to_csv(tmp_path / "car.csv", index=False)
    imu = pd.DataFrame({"t": drive.t[::2], "z": drive.gyro[::2]})
    imu[imu.t > 5.0].to_csv(tmp_path / "imu.csv", index=False)
    (tmp_path / "map.yaml").write_text(
        "tables: [{file: car.csv, time: {t: s}}, {file: imu.csv, time: {t: s}}]\n"
        "names: {x: car.x, y: car.y, yaw: car.yaw, throttle: car.throttle,\n"
        "        steering: car.steering, gyro: imu.z}\n"
    )
    recording = load_recording(tmp_path, tmp_path / "map.yaml")
    early = recording.data["t"][:, 0] < 4.8
    gyro = recording.data["gyro"][:, 0]
    assert bool(gyro[early].isnan().all())
    late = (recording.data["t"][:, 0] - 12.5).abs() < 7.4
    assert not bool(gyro[late].isnan().any())
