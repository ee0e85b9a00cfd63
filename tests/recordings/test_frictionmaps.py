"""The recordings of FrictionMaps, each five tables with jitter, holes and a noisy pose."""

import pytest

from buggy_rl.diagnosis.answer.other_sensors import other_sensors
from buggy_rl.recordings import load_recordings

SECONDS = {"DS1": 41.2, "DS2": 127.1, "DS3": 114.5, "DS4": 103.0, "DS5": 106.8}


@pytest.fixture(scope="module")
def loaded(frictionmaps_folder, repository):
    columns = repository / "configs" / "columns" / "frictionmaps.yaml"
    return load_recordings(frictionmaps_folder, columns, car="frictionmaps")


def test_all_drives_are_read_and_lose_what_they_must(loaded):
    recordings, refusals = loaded
    assert refusals == []
    assert {r.name: pytest.approx(r.duration, abs=0.5) for r in recordings} == SECONDS


def test_reverse_is_read_and_holes_and_impossible_speeds_are_noted(loaded):
    notes = {r.name: " ".join(r.notes) for r in loaded[0]}
    assert all("the car reverses" not in note for note in notes.values())
    [reversing] = [r for r in loaded[0] if r.name == "DS2"]
    assert reversing.data["velocity"][:, 0].min() < -1.5
    assert reversing.data["action"][:, 0].min() < -0.5
    assert "rows missing before it, up to 27.8 s" in notes["DS2"]
    assert "exceeds top_speed 9 m/s" in notes["DS1"]
    for recording in loaded[0]:
        assert recording.data["velocity"][:, :2].norm(dim=-1).max() <= 9.0


def test_the_gyro_agrees_with_the_pose_in_degrees_and_is_refused_as_radians(
    frictionmaps_folder, repository, tmp_path
):
    text = (repository / "configs" / "columns" / "frictionmaps.yaml").read_text()
    (tmp_path / "map.yaml").write_text(
        text.replace("units: {yaw_rate: deg/s, gyro", "units: {gyro")
    )
    _, refusals = load_recordings(frictionmaps_folder, tmp_path / "map.yaml", car="frictionmaps")
    assert len(refusals) == 5
    assert all("units: {yaw_rate: deg/s}" in str(refusal) for refusal in refusals)


def test_without_the_stated_rate_the_slow_drive_is_refused_with_the_right_one(
    frictionmaps_folder, repository, tmp_path
):
    text = (repository / "configs" / "columns" / "frictionmaps.yaml").read_text()
    (tmp_path / "map.yaml").write_text(text.replace("  slowest_rate: 19.0", "  gap_most: 3.0"))
    recordings, (refusal,) = load_recordings(
        frictionmaps_folder, tmp_path / "map.yaml", car="frictionmaps"
    )
    assert len(recordings) == 4
    assert "DS5" in str(refusal)
    assert "limits: {slowest_rate: 19}" in str(refusal)


def test_the_lidar_pose_comes_after_the_gyroscope_by_the_same_time_in_every_drive(loaded):
    found = [{f.name: f for f in other_sensors([recording])} for recording in loaded[0]]
    told = [findings for findings in found if "pose_lateness" in findings]
    assert len(told) == 5
    for findings in told:
        assert findings["pose_lateness"].value == pytest.approx(0.030, abs=0.006)
        assert findings["gyro_scale"].value == pytest.approx(1.0, abs=0.03)  # read as deg/s
