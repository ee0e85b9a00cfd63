"""A uniform grid: exact on rows, close in between, and never across a gap."""

import numpy as np
import pytest

from buggy_rl.recordings import ColumnMap, load_recording

VELOCITY = ["vx", "vy", "yaw_rate"]


def grid_is_uniform(recording):
    t = recording.data["t"][:, 0].numpy()
    number = (t - t[0]) / recording.dt
    assert np.abs(number - np.round(number)).max() < 1e-4
    inside = np.diff(recording.data["segment"].numpy()) == 0
    assert np.allclose(np.diff(t)[inside], recording.dt, atol=2e-6)
    return t


@pytest.mark.parametrize("rate", [20, 30, 50, 137, 200])
def test_the_pose_between_rows_is_that_of_the_car(rate, make_drive, write):
    truth = make_drive(rate=1000)
    recording = load_recording(write(make_drive(rate=rate)))
    t = grid_is_uniform(recording)
    for column, name in enumerate(["x", "y"]):
        expected = np.interp(t, truth.t, truth[name])
        # cubic: error about a''' h^3 / 24 < 20 * 0.05^3 / 24 = 0.1 mm at 20 Hz
        assert np.abs(recording.data["pose"][:, column] - expected).max() < 5e-4
    turned = np.interp(t, truth.t, np.unwrap(truth.yaw))
    assert np.abs(recording.data["pose"][:, 2] - turned).max() < 2e-3


def test_yaw_is_unwrapped_within_a_segment(make_drive, write):
    frame = make_drive()
    cos, sin = np.cos(2.2), np.sin(2.2)  # the world turned by 2.2 rad: yaw passes pi
    x, y = cos * frame.x - sin * frame.y, sin * frame.x + cos * frame.y
    yaw = np.remainder(frame.yaw + 2.2 + np.pi, 2 * np.pi) - np.pi
    frame = frame.assign(x=x, y=y, yaw=yaw)
    assert np.abs(np.diff(frame.yaw)).max() > 6
    recording = load_recording(write(frame))
    assert recording.data["pose"][:, 2].diff().abs().max() < 0.02


@pytest.mark.parametrize(("noise", "bounds"), [(2e-4, (0.006, 0.006, 0.03)), (0, (2e-3,) * 3)])
def test_derived_velocities_are_those_of_the_car(noise, bounds, make_drive, write):
    truth, seen = make_drive(), make_drive(noise=noise)
    recording = load_recording(write(seen.drop(columns=VELOCITY)))
    error = recording.data["velocity"].numpy() - truth[VELOCITY].to_numpy()
    # 15 rows, cubic: rms noise of the slope 3.5 sigma; 0.7 mm/s and 2.8 mrad/s, ends are worse
    assert (np.sqrt((error**2).mean(0)) < bounds).all()
    assert "Savitzky-Golay, order 3, 15 rows (0.15 s, half of it ahead)" in recording.notes[-1]


def test_velocities_are_derived_on_request_even_where_measured(make_drive, write):
    path = write(make_drive(noise=1e-3))
    measured, derived = (load_recording(path, ColumnMap(derive_velocity=d)) for d in (False, True))
    assert measured.notes == []
    assert "vx, vy, yaw_rate derived" in derived.notes[-1]
    assert derived.derived == ("vx", "vy", "yaw_rate")
    assert measured.derived == ()
    assert not np.allclose(measured.data["velocity"], derived.data["velocity"], atol=1e-3)


def test_only_what_is_missing_is_derived(make_drive, write):
    frame = make_drive(noise=2e-4)
    recording = load_recording(write(frame.drop(columns="yaw_rate")))
    assert recording.notes[-1].startswith("yaw_rate derived")
    assert recording.derived == ("yaw_rate",)
    assert np.allclose(recording.data["velocity"][:, :2], frame[["vx", "vy"]], atol=1e-6)


def test_a_command_is_the_last_one_at_or_before_the_grid_time(make_drive, write):
    frame = make_drive(rate=40, seconds=8)  # rows each 0.025 s, grid each 0.01 s
    frame["steering"] = np.arange(len(frame)) / 400  # identifiable: row / 400
    recording = load_recording(write(frame))
    t = recording.data["t"][:, 0].numpy()
    row = np.floor(t / 0.025 + 1e-6)
    assert np.allclose(recording.data["action"][:, 1], row / 400, atol=1e-6)


@pytest.mark.parametrize("offset", [-0.1, -0.033, 0.0, 0.05])
def test_a_clock_offset_moves_commands_by_that_time(offset, make_drive, write):
    frame = make_drive(seconds=8)
    frame["steering"] = np.arange(len(frame)) / 1000  # row / 1000, stamped row * 0.01 s
    recording = load_recording(write(frame), ColumnMap(command_offset=offset))
    t = recording.data["t"][:, 0].numpy()
    row = np.minimum(np.floor((t - offset) / 0.01 + 1e-4), len(frame) - 1)
    assert np.allclose(recording.data["action"][:, 1], row / 1000, atol=1e-6)
    if offset > 0:  # the first 0.05 s have no command
        assert t[0] == pytest.approx(0.05, abs=1e-6)
        assert [note for note in recording.notes if "no command within" in note]


def test_an_early_clock_leaves_the_end_of_a_gap_without_commands(make_drive, write):
    # stamps - 0.3 s: rows up to 3.99 s give commands up to 3.69 s, held 0.1 s: 3.80-3.99 have none
    frame = make_drive(seconds=8, noise=2e-4).drop(index=range(400, 500))
    recording = load_recording(write(frame), ColumnMap(command_offset=-0.3))
    t = recording.data["t"][:, 0].numpy()
    assert t[recording.data["segment"] == 0][-1] == pytest.approx(3.79, abs=1e-6)
    assert t[recording.data["segment"] == 1][0] == pytest.approx(5.0, abs=1e-6)
    assert [note for note in recording.notes if "no command within 0.1 s" in note]


def test_nothing_is_carried_across_a_gap(make_drive, write):
    frame = make_drive(noise=2e-4).drop(columns=VELOCITY)
    whole = load_recording(write(frame))
    cut = load_recording(write(frame.drop(index=range(1000, 1100))))
    grid_is_uniform(cut)
    t, segment = cut.data["t"][:, 0].numpy(), cut.data["segment"].numpy()
    assert (segment == (t > 10.5)).all()
    assert not ((t > 9.995) & (t < 10.995)).any()
    # the smoother sees 0.075 s each way: further from the gap nothing changes
    far = np.abs(t - 10.495) > 0.6
    same = whole.data["velocity"].numpy()[np.round(t / 0.01).astype(int)]
    assert np.allclose(cut.data["velocity"][far], same[far], atol=1e-5)


def test_a_jump_does_not_leak_into_the_velocities(make_drive, write):
    frame = make_drive(noise=2e-4).drop(columns=VELOCITY)
    frame.loc[700:, "x"] += 2.0
    recording = load_recording(write(frame))
    assert recording.data["velocity"][:, :2].abs().max() < 2.5


def test_the_control_period_can_be_chosen(make_drive, write):
    recording = load_recording(write(make_drive(seconds=10)), dt=0.02)
    assert recording.dt == 0.02
    assert len(recording) == 500
    grid_is_uniform(recording)
    with pytest.raises(ValueError, match="dt is -1"):
        load_recording("any.csv", dt=-1)


def test_a_segment_that_begins_a_microsecond_after_the_grid_has_numbers(make_drive, write):
    # Stamps are rounded to microseconds, so a start exactly SNAP after a grid time occurs.
    frame = make_drive(seconds=20)
    part = (frame.t // 0.5).astype(int)  # parts of 0.5 s, each begun after a gap of 0.1 s
    frame = frame[frame.t % 0.5 >= 0.1].assign(t=(frame.t + 1e-6 * (part > 0)).round(6))
    recording = load_recording(write(frame))
    assert len(recording.data["segment"].unique()) == 40
    assert recording.data["pose"].isfinite().all()
