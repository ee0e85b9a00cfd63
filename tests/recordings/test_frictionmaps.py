"""The recordings of FrictionMaps, each five tables with jitter, holes and a noisy pose."""

import pytest

from buggy_rl.recordings import load_recordings

SECONDS = {"DS1": 40.7, "DS2": 123.0, "DS3": 113.5, "DS4": 99.2, "DS5": 105.0}


@pytest.fixture(scope="module")
def loaded(frictionmaps_folder, repository):
    columns = repository / "configs" / "columns" / "frictionmaps.yaml"
    return load_recordings(frictionmaps_folder, columns, car="frictionmaps")


def test_all_drives_are_read_and_lose_what_they_must(loaded):
    recordings, refusals = loaded
    assert refusals == []
    assert {r.name: pytest.approx(r.duration, abs=0.5) for r in recordings} == SECONDS


def test_reverse_holes_and_impossible_speeds_are_noted(loaded):
    notes = {r.name: " ".join(r.notes) for r in loaded[0]}
    assert "the car reverses" in notes["DS2"]
    assert "rows missing before it, up to 27.8 s" in notes["DS2"]
    assert "exceeds top_speed 9 m/s" in notes["DS1"]
    for recording in loaded[0]:
        assert recording.data["velocity"][:, :2].norm(dim=-1).max() <= 9.0


def test_the_gyro_agrees_with_the_pose_in_degrees_and_is_refused_as_radians(
    frictionmaps_folder, repository, tmp_path
):
    text = (repository / "configs" / "columns" / "frictionmaps.yaml").read_text()
    (tmp_path / "map.yaml").write_text(text.replace("units: {yaw_rate: deg/s}", ""))
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
