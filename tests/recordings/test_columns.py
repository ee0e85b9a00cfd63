"""The column map: each setting has its effect, and unknown ones are refused."""

import numpy as np
import pytest

from buggy_rl.recordings import ColumnMap, RecordingError, load_recording
from buggy_rl.recordings.columns import load_columns

POSE = ["x", "y", "yaw"]


@pytest.fixture
def frame(make_drive):
    return make_drive(seconds=8.0, noise=2e-4)


@pytest.fixture
def read(frame, write, tmp_path):
    """Reads a table with a map given as YAML, and the original table with none."""

    def load(changed, text):
        (tmp_path / "map.yaml").write_text(text)
        path = write(changed, "changed.csv")
        return load_recording(path, tmp_path / "map.yaml"), load_recording(write(frame))

    return load


def same(recording, expected, keys=("pose", "velocity", "action"), atol=1e-5):
    for key in keys:
        assert np.allclose(recording.data[key], expected.data[key], atol=atol), key


def test_names_units_and_signs_bring_a_foreign_table_to_the_standard(frame, read):
    foreign = {
        "time [ms]": 1000 * frame.t,
        "px": 100 * frame.x,
        "py": -1000 * frame.y,
        "heading": -np.degrees(frame.yaw),
        "speed": 3.6 * frame.vx,
        "drift": -frame.vy,
        "gyro": -np.degrees(frame.yaw_rate),
        "gas": frame.throttle,
        "wheel": -frame.steering,
    }
    text = """
names: {t: "time [ms]", x: px, y: py, yaw: heading, vx: speed, vy: drift, yaw_rate: gyro,
        throttle: gas, steering: wheel}
units: {t: ms, x: cm, y: mm, yaw: deg, vx: km/h, yaw_rate: deg/s}
signs: {y: -1, yaw: -1, vy: -1, yaw_rate: -1, steering: -1}
"""
    same(*read(frame[[]].assign(**foreign), text))


def test_throttle_maps_rest_to_no_drive_and_clips_braking_with_a_note(frame, read):
    raw = np.linspace(1000, 2000, len(frame))  # a servo pulse [us]: 1500 rests, 2000 is full
    text = "throttle: {rest: 1500, full: 2000, lowest: 1000}"
    recording, _ = read(frame.assign(throttle=raw), text)
    throttle = recording.data["action"][:, 0].numpy()
    assert (throttle[raw <= 1500] == -1).all()
    assert throttle[-1] == 1
    # 1750 us is half of the way: share 0.5, throttle 2 * 0.5 - 1 = 0
    assert np.interp(1750, raw, throttle) == pytest.approx(0, abs=1e-5)
    (note,) = [note for note in recording.notes if "clipped" in note]
    assert note.startswith("rows 0-399, column throttle")


def test_without_a_range_for_braking_the_recording_is_refused(frame, read):
    raw = np.linspace(-0.5, 1, len(frame))
    with pytest.raises(RecordingError, match="row 0, column throttle"):
        read(frame.assign(throttle=raw), "throttle: {rest: 0, full: 1}")


def test_a_factor_scales_the_drive_and_not_the_rest(frame, read):
    safe = (frame.t > 4).astype(float)
    raw = frame.throttle * 100 + 300  # -1 -> 200, +1 -> 400
    text = "throttle: {rest: 200, full: 400, factor: safe}"
    recording, original = read(frame.assign(throttle=raw, safe=safe), text)
    throttle = recording.data["action"][:, 0]
    assert (throttle[frame.t.to_numpy() <= 4] == -1).all()
    on = frame.t.to_numpy() > 4
    assert np.allclose(throttle[on], original.data["action"][on, 0], atol=1e-5)


def test_steering_ends_may_differ_and_be_turned_round(frame, read):
    # +1 (left) -> 1100 us, 0 -> 1480 us, -1 -> 2000 us
    raw = 1480 - np.where(frame.steering > 0, 380, 520) * frame.steering
    text = "steering: {left: 1100, centre: 1480, right: 2000}"
    same(*read(frame.assign(steering=raw), text))


def test_leading_rows_are_dropped_and_keep_their_numbers(frame, read):
    waiting = (frame.t >= 1.0).astype(float)
    changed = frame.assign(ready=waiting, throttle=frame.throttle.where(frame.t != 2.0, 9.0))
    text = "drop_leading: {column: ready, equals: 0}"
    with pytest.raises(RecordingError) as caught:
        read(changed, text)
    assert caught.value.row == 200
    recording, original = read(frame.assign(ready=waiting), text)
    assert len(recording) == len(original) - 100
    assert "rows 0-99, column ready" in recording.notes[0]


@pytest.mark.parametrize("velocity", ["measured", "derived"])
def test_a_mount_moves_pose_and_velocity_to_the_reference_point(velocity, frame, read):
    # A second tracker 0.1 m ahead, 0.05 m to the left, turned 0.2 rad to the left:
    # p' = p + R(yaw) (0.1, 0.05), v' = R(-0.2) (vx - 0.05 r, vy + 0.1 r), yaw' = yaw + 0.2
    cos, sin = np.cos(frame.yaw), np.sin(frame.yaw)
    vx, vy = frame.vx - 0.05 * frame.yaw_rate, frame.vy + 0.1 * frame.yaw_rate
    changed = frame.assign(
        x=frame.x + 0.1 * cos - 0.05 * sin,
        y=frame.y + 0.1 * sin + 0.05 * cos,
        yaw=frame.yaw + 0.2,
        vx=np.cos(0.2) * vx + np.sin(0.2) * vy,
        vy=-np.sin(0.2) * vx + np.cos(0.2) * vy,
    )
    text = "mount: {x: 0.1, y: 0.05, yaw: 0.2}"
    if velocity == "derived":
        text += "\nderive_velocity: true"
        recording, original = read(changed, text)
        same(recording, original, ["pose"])
        same(recording, original, ["velocity"], atol=0.06)
    else:
        same(*read(changed, text))


def test_world_frame_velocities_are_turned_into_the_body(frame, read):
    cos, sin = np.cos(frame.yaw), np.sin(frame.yaw)
    changed = frame.assign(vx=cos * frame.vx - sin * frame.vy, vy=sin * frame.vx + cos * frame.vy)
    same(*read(changed, "velocity_frame: world"))


def test_ignored_columns_are_as_if_they_were_not_there(frame, read):
    recording, _ = read(frame.assign(vx=99.0), "ignore: [vx, vy]")
    assert "vx, vy derived" in recording.notes[-1]


def test_time_can_count_from_the_first_row(frame, read):
    recording, original = read(frame.assign(t=frame.t + 1.7e9), "time_from_first: true")
    assert recording.data["t"][0] == 0
    same(recording, original, atol=1e-4)  # stamps since 1970 resolve 2.4e-7 s
    assert "counted from 1700000000.000 s" in recording.notes[0]


def test_a_stated_column_that_is_missing_is_refused_with_what_there_is(frame, read):
    with pytest.raises(RecordingError, match=r"column speed: missing; available: t, x, y"):
        read(frame, "names: {vx: speed}")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: {t: time}", "unknown key 'name'; did you mean 'names'?"),
        ("names: {time: t}", "unknown time; available: t, x, y"),
        ("units: {yaw: degrees}", "unit of yaw: unknown degrees; available: rad, deg"),
        ("units: {throttle: us}", "unit of throttle"),
        ("signs: {y: -2}", "write 1 or -1"),
        ("throttle: {rest: 0, ful: 1}", "unknown key 'throttle.ful'"),
        ("throttle: {rest: 1, full: 1}", "both 1.0"),
        ("throttle: 5", "5"),
        ("[names]", "expected keys and values"),
        ("mount: {yaw: left}", "mount.yaw: Value 'left'"),
        ("velocity_frame: car", "expected one of ['body', 'world']"),
        ("ignore: {vx: 1}", "a list is expected"),
        ("topics: {action_fields: [x]}", "needs two names"),
        ("names: {t: [", "map.yaml"),
    ],
)
def test_a_wrong_column_map_is_refused_with_the_file_and_what_is_possible(text, words, tmp_path):
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(ValueError, match=r"map\.yaml") as caught:
        load_columns(tmp_path / "map.yaml")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_empty_map_is_the_standard_table(tmp_path):
    (tmp_path / "map.yaml").write_text("# nothing\n")
    assert load_columns(tmp_path / "map.yaml") == ColumnMap()


def test_limits_can_be_loosened(frame, write, tmp_path):
    (tmp_path / "map.yaml").write_text("limits: {gap_periods: 2.5}")
    path = write(frame.drop(index=[300]))
    assert load_recording(path).data["segment"].max() == 1
    assert load_recording(path, tmp_path / "map.yaml").data["segment"].max() == 0


def test_every_shipped_map_can_be_read(repository):
    maps = sorted((repository / "configs" / "columns").glob("*.yaml"))
    assert maps
    for file in maps:
        assert isinstance(load_columns(file), ColumnMap)
