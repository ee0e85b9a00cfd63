"""The recordings of DART, read with the shipped column map."""

import numpy as np
import pandas as pd
import pytest

from buggy_rl.recordings import load_recordings

RECORDINGS = {
    "91_free_driving_16_sept_2024/*10_27_02.csv": (104.4, 1),
    "81_throttle_ramps/*16_09_11*.csv": (80.9, 3),
    "steering_identification_25_sept_2024/*10_02_32.csv": (15.2, 1),
}
"""Pattern -> usable seconds and segments."""


@pytest.fixture(scope="module")
def columns(repository):
    return repository / "configs" / "columns" / "dart.yaml"


def encoder(recording):
    """The wheel encoder on the recording's grid [m/s], an independent witness of vx."""
    frame = pd.read_csv(recording.source)
    t = frame["vicon time"].to_numpy()
    first = int((frame["elapsed time sensors"] != 0).to_numpy().argmax())
    return np.interp(recording.data["t"][:, 0], t - t[first], frame["vel encoder"])


@pytest.mark.parametrize("pattern", RECORDINGS)
def test_a_recording_loads_without_the_rows_that_the_cameras_lost(pattern, dart_folder, columns):
    (recording,), refusals = load_recordings(f"{dart_folder}/{pattern}", columns)
    seconds, segments = RECORDINGS[pattern]
    assert refusals == []
    assert recording.duration == pytest.approx(seconds, abs=0.1)
    assert recording.data["segment"][-1] == segments - 1


def test_derived_velocities_agree_with_the_wheels_and_the_steering(dart_folder, columns):
    (recording,), _ = load_recordings(f"{dart_folder}/91_free*/*10_02_28.csv", columns)
    vx, vy, yaw_rate = recording.data["velocity"].numpy().T
    throttle, steering = recording.data["action"].numpy().T
    moving = vx > 0.4
    assert np.median(vx[moving] / encoder(recording)[moving]) == pytest.approx(1.0, abs=0.02)
    straight = moving & (np.abs(yaw_rate) < 0.15)
    assert abs(np.median(vy[straight] / vx[straight])) < 0.006  # the mounting error is undone
    assert np.corrcoef(steering[moving], yaw_rate[moving] / vx[moving])[0, 1] > 0.9
    assert throttle.min() == -1
    assert throttle.max() == pytest.approx(2 * 0.43 - 1, abs=0.01)


@pytest.mark.slow
def test_all_31_recordings_are_usable_and_plausible(dart_folder, columns):
    recordings, refusals = load_recordings(dart_folder, columns)
    assert refusals == []
    assert len(recordings) == 31
    assert sum(recording.duration for recording in recordings) == pytest.approx(2066, abs=5)
    for recording in recordings:
        vx, vy, yaw_rate = recording.data["velocity"].abs().amax(0)
        assert vx < 4.5
        assert vy < 0.6
        assert yaw_rate < 4.5
        speed, wheels = recording.data["velocity"][:, 0].numpy(), encoder(recording)
        moving = speed > 0.4
        ratio = np.median(speed[moving] / np.maximum(wheels[moving], 0.05))
        assert 0.92 < ratio < 1.02  # the driven wheels slip at the limit
