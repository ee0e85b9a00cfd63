"""Recordings as other cars and trackers make them: reverse, stairs, noise, dead zones."""

import runpy

import numpy as np
import pandas as pd
import pytest

from buggy_rl.recordings import ColumnMap, RecordingError, load_recording
from buggy_rl.recordings.columns import SteeringRange
from buggy_rl.recordings.recording import Limits

POSE = ["x", "y", "yaw"]
VELOCITY = ["vx", "vy", "yaw_rate"]
REVERSING = 6.5, 10.5  # [s] in which `pace` is negative


def retraced(frame: pd.DataFrame) -> pd.DataFrame:
    """The same car, which stops after 6 s, backs up along its path, and goes on forward."""
    t = np.arange(0, 16, 0.01)
    pace = np.interp(t, [0, 6, 7, 10, 11, 16], [1, 1, -1, -1, 1, 1])
    at = np.concatenate([[0], np.cumsum((pace[1:] + pace[:-1]) / 2 * 0.01)])
    frame = frame.assign(yaw=np.unwrap(frame.yaw))
    table = {name: np.interp(at, frame.t, frame[name]) for name in frame.columns}
    for name in VELOCITY:
        table[name] = table[name] * pace
    return pd.DataFrame({**table, "t": t})


@pytest.mark.parametrize("velocity", ["measured", "derived"])
def test_reverse_is_cut_out_and_the_rest_is_used(make_drive, write, velocity):
    frame = retraced(make_drive(noise=2e-4))
    if velocity == "derived":
        frame = frame.drop(columns=VELOCITY)
    recording = load_recording(write(frame))
    (note,) = [note for note in recording.notes if "reverses" in note]
    assert "column yaw" in note
    t = recording.data["t"][:, 0].numpy()
    begin, end = REVERSING
    assert not ((t > begin + 0.1) & (t < end - 0.1)).any()
    assert recording.duration == pytest.approx(16 - (end - begin), abs=0.4)
    assert recording.data["velocity"][:, 0].min() > -0.15  # [m/s] noise while it stops


def test_a_drive_mostly_in_reverse_keeps_its_forward_part(make_drive, write):
    frame = retraced(make_drive(noise=2e-4)).iloc[450:1200].reset_index(drop=True)
    assert load_recording(write(frame)).duration == pytest.approx(3.5, abs=0.4)


def test_a_car_that_only_reverses_is_refused_with_both_causes(make_drive, write):
    frame = retraced(make_drive(noise=2e-4)).iloc[700:1000].reset_index(drop=True)
    with pytest.raises(RecordingError, match=r"mount: \{yaw: .*; if the car reverses throughout"):
        load_recording(write(frame))


def test_forward_driving_is_not_taken_for_reverse(good, write):
    assert not [note for note in load_recording(write(good)).notes if "reverses" in note]


def noisy_filter(frame: pd.DataFrame) -> pd.DataFrame:
    """A particle filter: 2 cm of noise, and a leap of 1.2 m that returns after 0.15 s."""
    random = np.random.default_rng(3)
    xy = frame[["x", "y"]] + 0.02 * random.standard_normal((len(frame), 2))
    xy.loc[(frame.t > 9.0) & (frame.t < 9.15), "x"] += 0.9
    return frame.assign(x=xy.x, y=xy.y).drop(columns=VELOCITY)


def test_no_speed_above_the_top_speed_reaches_the_recording(make_drive, write):
    frame = noisy_filter(make_drive(rate=50))
    limits = Limits(top_speed=6.0, leap=2.0)  # the leap passes as noise does: the speed must not
    recording = load_recording(write(frame), ColumnMap(limits=limits))
    (note,) = [note for note in recording.notes if "exceeds top_speed 6 m/s" in note]
    assert "cut, with" in note
    assert recording.data["velocity"][:, :2].norm(dim=-1).max() <= 6.0
    assert recording.data["segment"].max() >= 1
    assert recording.duration > 18.5


def test_a_rate_just_too_low_names_the_limit_and_the_value_that_admits_it(make_drive, write):
    path = write(make_drive(rate=19.6))
    with pytest.raises(RecordingError, match=r"limits: \{slowest_rate: 19\}"):
        load_recording(path)
    assert load_recording(path, ColumnMap(limits=Limits(slowest_rate=19))).duration > 19


def stairs(frame: pd.DataFrame, columns: list[str], rate: float) -> pd.DataFrame:
    """A slow tracker in fast rows: columns hold the last value of a clock of `rate` [Hz]."""
    last = np.floor(frame.t * rate + 1e-9) / rate
    return frame.assign(**{c: np.interp(last, frame.t, frame[c]) for c in columns})


def test_positions_in_stairs_beside_a_smooth_heading_keep_their_own_rows(make_drive, write):
    frame = make_drive(noise=0.0, agility=2.0).drop(columns=VELOCITY)
    recording = load_recording(write(stairs(frame, ["x", "y"], 25.0)))
    assert [note for note in recording.notes if "slower than the rows" in note]
    assert recording.duration > 19.5
    assert recording.data["segment"].max() <= 1  # the start from rest


def test_quantised_positions_are_no_stairs(make_drive, write):
    frame = make_drive(noise=0.0, agility=2.0)
    frame = frame.assign(x=frame.x.round(2), y=frame.y.round(2))
    recording = load_recording(write(frame))
    assert not [note for note in recording.notes if "slower than the rows" in note]
    assert recording.duration > 19.9


def test_stairs_too_slow_or_uneven_are_refused_with_what_to_do(make_drive, write):
    frame = make_drive(noise=0.0).drop(columns=VELOCITY)
    with pytest.raises(RecordingError, match="the pose changes at 10 Hz"):
        load_recording(write(stairs(frame, POSE, 10.0)))
    with pytest.raises(RecordingError, match="thin the table to the pose's own rate"):
        load_recording(write(stairs(frame, POSE, 78.0)))


def test_a_dead_zone_of_the_steering_maps_to_zero_and_both_locks_to_one(make_drive, write):
    frame = make_drive(seconds=6.0)
    raw = np.linspace(1000, 2100, len(frame))
    columns = ColumnMap(steering=SteeringRange(left=1000, centre=1500, right=2100, deadband=50))
    action = load_recording(write(frame.assign(steering=raw)), columns).data["action"][:, 1].numpy()
    assert action[0] == 1
    assert action[-1] == -1
    assert (action[np.abs(raw - 1500) <= 50] == 0).all()
    # left: 1450 - 1000 = 450 from the edge to the lock; right: 550
    assert np.allclose(action[raw < 1450], (1450 - raw[raw < 1450]) / 450, atol=1e-5)
    assert np.allclose(action[raw > 1550], -(raw[raw > 1550] - 1550) / 550, atol=1e-5)


@pytest.mark.parametrize("deadband", [-1.0, 500.0])
def test_a_dead_zone_wider_than_the_lock_is_refused(deadband):
    with pytest.raises(ValueError, match="below 500"):
        ColumnMap(steering=SteeringRange(left=1000, centre=1500, right=2100, deadband=deadband))


def test_a_switch_before_a_setting_of_the_checking_script_is_understood(
    good, write, repository, monkeypatch, capsys
):
    path = write(good)
    words = ["check_recordings.py", str(path), "--notes", "dt=0.02"]
    monkeypatch.setattr("sys.argv", words)
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(str(repository / "scripts" / "check_recordings.py"), run_name="__main__")
    assert "1 recordings usable" in capsys.readouterr().out


def test_a_position_on_a_map_grid_loses_no_digits_and_two_drives_share_a_frame(good, write):
    near = load_recording(write(good))
    far = good.assign(x=good.x + 500_000.0, y=good.y + 5_300_000.0)
    found = load_recording(write(far, "far.csv"))
    [note] = [n for n in found.notes if "positions count from" in n]
    assert "column x: positions count from (500000, 5300000) m" in note
    # float32 resolves 0.5 m at 5300 km; stamps, commands and headings are as they were.
    assert found.data["pose"].numpy() == pytest.approx(near.data["pose"].numpy(), abs=2e-3)
    assert not [n for n in near.notes if "positions count" in n]
