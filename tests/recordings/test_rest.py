"""Where a throttle rests, seen from the motion: a one-way throttle at -1, half drive at 0."""

import numpy as np
import pandas as pd
import pytest

from buggy_rl.recordings import RecordingError, load_recording, load_recordings
from buggy_rl.recordings.loading import telling

DT = 0.01  # [s]
FORCE, DRAG, ROLL = 6.0, 1.0, 0.6  # full drive [m/s^2], drag [1/s], rolling resistance [m/s^2]


def driven(drive, steering=None):
    """A car on commands in drive, -1 to 1, that reverses below 0 from a standstill.

    dv/dt = FORCE drive - DRAG v - ROLL sign(v).
    """
    v, speeds = 0.0, []
    for u in drive:
        speeds.append(v)
        pull = FORCE * u - DRAG * v
        if v == 0.0 and abs(pull) < ROLL:
            continue
        resisting = ROLL * np.sign(v if v else pull)
        after = v + DT * (pull - resisting)
        v = 0.0 if v * after < 0 else after
    speed = np.array(speeds)
    t = DT * np.arange(len(speed))
    steering = 0.3 * np.sin(1.1 * t) if steering is None else steering
    yaw = np.cumsum(speed * steering) * DT
    noise = 2e-4 * np.random.default_rng(0).standard_normal((3, len(t)))
    x, y = np.cumsum(speed * np.cos(yaw)) * DT, np.cumsum(speed * np.sin(yaw)) * DT
    table = {"t": t, "x": x + noise[0], "y": y + noise[1], "yaw": yaw + 4 * noise[2]}
    return pd.DataFrame({**table, "throttle": drive, "steering": steering})


def bursts(level=0.5, seconds=24, rest=0.0):
    """Two seconds of drive, two at rest, and so on."""
    t = np.arange(0, seconds, DT)
    return np.where(t % 4 < 2, level, rest)


def refusal(path) -> RecordingError:
    with pytest.raises(RecordingError) as caught:
        load_recording(path)
    return caught.value


def test_a_throttle_from_0_to_1_that_rests_at_0_is_refused_and_its_map_reads_it(write, tmp_path):
    path = write(driven(bursts()))
    error = refusal(path)
    assert error.column == "throttle"
    assert "state throttle: {rest: 0} in a column map" in str(error)
    (tmp_path / "map.yaml").write_text("throttle: {rest: 0}\n")
    action = load_recording(path, tmp_path / "map.yaml").data["action"][:, 0]
    assert sorted({round(float(u), 3) for u in action}) == [-1.0, 0.0]


@pytest.mark.parametrize("lowest", [-0.4, -1.0])
def test_a_throttle_that_brakes_below_0_is_refused_and_its_map_reads_it(lowest, write, tmp_path):
    t = np.arange(0, 24, DT)
    drive = np.select([t % 6 < 2, t % 6 < 2.3, t % 6 < 2.5], [0.6, 0.0, lowest], 0.0)
    path = write(driven(drive))
    assert "command: {kind: throttle_brake_reverse}" in str(refusal(path))
    (tmp_path / "map.yaml").write_text("command: {kind: throttle_brake_reverse}\n")
    recording = load_recording(path, tmp_path / "map.yaml")
    assert recording.duration > 23
    assert recording.data["action"][:, 0].min() == pytest.approx(lowest)


def test_a_car_that_reverses_is_not_read_in_part_with_half_drive_at_rest(write):
    t = np.arange(0, 24, DT)
    drive = np.select([t % 8 < 2, t % 8 < 4, t % 8 < 6], [0.5, 0.0, -0.4], 0.0)
    frame = driven(drive)
    assert "command: {kind: throttle_brake_reverse}" in str(refusal(write(frame)))
    swinging = 0.5 * np.sin(0.8 * t)  # never at rest for long
    assert "while the car reverses" in str(refusal(write(driven(swinging))))


def test_a_limit_admits_what_is_half_drive_in_spite_of_it(write, tmp_path):
    path = write(driven(bursts()))
    (tmp_path / "map.yaml").write_text("limits: {zero_rest_share: 1}\n")
    assert load_recording(path, tmp_path / "map.yaml").duration > 23


def one_way(drive):
    """The command of a one-way throttle for a drive of 0 to 1."""
    return 2 * drive - 1


@pytest.mark.parametrize("level", [0.5, 0.3, 0.8])
def test_a_one_way_throttle_is_accepted_at_half_drive_too(level, write):
    frame = driven(bursts(level))
    assert load_recording(write(frame.assign(throttle=one_way(frame.throttle)))).duration > 23


def test_half_drive_that_is_slower_than_what_came_before_is_no_rest(write):
    t = np.arange(0, 24, DT)
    frame = driven(np.where(t % 6 < 3, 1.0, 0.5))  # from 5.4 to 2.4 m/s and back
    assert load_recording(write(frame.assign(throttle=one_way(frame.throttle)))).duration > 23


def test_a_throttle_that_is_0_for_a_moment_is_no_rest(write):
    t = np.arange(0, 24, DT)
    drive = np.clip(0.5 + 0.5 * np.sin(2.5 * t), 0, 1)
    frame = driven(drive)
    assert load_recording(write(frame.assign(throttle=one_way(drive)))).duration > 23


def test_the_sample_drives_are_accepted_and_have_nothing_to_tell(repository):
    recordings, refusals = load_recordings(repository / "data" / "sample")
    assert refusals == []
    assert len(recordings) == 9
    assert [note for recording in recordings for note in telling(recording.notes)] == []


def test_a_car_that_gets_faster_without_drive_is_refused_and_a_coasting_one_is_not(write, tmp_path):
    frame = driven(bursts())
    pushed = frame.assign(throttle=-1.0)
    error = refusal(write(pushed))
    assert "pushed or carried, or its command is another column" in str(error)
    (tmp_path / "map.yaml").write_text("limits: {undriven_gain: 3}\n")
    assert load_recording(write(pushed), tmp_path / "map.yaml").duration > 23
    rolling = frame[(frame.t > 1.9) & (frame.t < 4)].assign(throttle=-1.0)
    assert load_recording(write(rolling)).duration > 1.5
