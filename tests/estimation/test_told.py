"""What is doubtful about a study's drives is told when they are read."""

from buggy_rl.estimation.fit_study import DataConfig, load_drives
from tests.recordings.conftest import ideal_drive


def test_doubtful_drives_are_told_by_name(tmp_path):
    frame = ideal_drive(seconds=10.0, noise=2e-4).drop(columns=["vx", "vy", "yaw_rate"])
    for number in range(3):
        turned = frame.assign(yaw=frame.yaw + 0.5 * (number == 1))
        turned.to_csv(tmp_path / f"drive_{number}.csv", index=False)
    told = []
    load_drives(DataConfig(recordings=[str(tmp_path)]), told.append)
    assert len(told) == 1
    assert told[0].startswith("drive_1: ")
    assert "if the tracker is mounted so" in told[0]
