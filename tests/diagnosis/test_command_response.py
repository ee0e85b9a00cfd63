"""Commands that cannot have moved the car are told from those that did, whatever is concealed."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.diagnosis import pipeline
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.preflight.commands import check_commands, yaw_response
from buggy_rl.recordings import Recording
from tests.diagnosis.planted import commands, planted_drives

LARGE = {
    "nothing": {},
    "late": {"steering_dead_time": {"dead_time": 0.3}, "throttle_dead_time": {"dead_time": 0.3}},
    "gentle": {"steering_gain": {"gain": 0.3}, "throttle_gain": {"gain": 0.6}},
    "slow": {"steering_lag": {"time_constant": 0.3}, "sensor_latency": {"dead_time": 0.2}},
    "icy": {"tire_grip": {"grip": 0.3}},
    "loose": {"steering_backlash": {"width": 0.4}, "gyro_bias": {"bias": 0.5}},
    "askew": {"sensor_yaw": {"angle": 0.8}, "steering_offset": {"offset": 0.3}},
}


@pytest.fixture(scope="module")
def drives():
    made = planted_drives(list(LARGE.values()), cars=2, seconds=16.0)
    return dict(zip(LARGE, made, strict=True))


def changed(recording, action=None, velocity=None):
    data = recording.data.clone()
    if action is not None:
        data[keys.ACTION] = action
    if velocity is not None:
        data[keys.VELOCITY] = velocity
    return replace(recording, data=data)


def exchanged(recordings):
    return [changed(r, r.data[keys.ACTION].flip(-1)) for r in recordings]


@pytest.mark.parametrize("planted", LARGE)
def test_nothing_is_said_of_a_car_that_follows_its_commands_however_badly(drives, planted):
    found = check_commands(drives[planted])
    assert (found.first, found.notes) == ([], [])
    # On ice it spins most of the time.
    assert yaw_response(drives[planted]).given > (0.2 if planted == "icy" else 0.5)


@pytest.mark.parametrize("planted", [name for name in LARGE if name != "icy"])
def test_exchanged_columns_are_said_with_the_map_that_exchanges_them(drives, planted):
    [first] = check_commands(exchanged(drives[planted])).first
    assert "exchanged they do" in first
    assert "names: {throttle: steering, steering: throttle}" in first


def test_commands_of_another_drive_are_said_not_to_predict_the_motion(drives):
    one, other = drives["nothing"]
    mixed = [changed(one, other.data[keys.ACTION]), changed(other, one.data[keys.ACTION])]
    [first] = check_commands(mixed).first
    assert first.startswith("The commands do not predict the motion: of the yaw rate's variance")
    assert "exchanged" not in first


def test_a_steady_drive_tells_nothing_and_is_not_blamed():
    action = torch.tensor([-0.4, 0.3]).expand(1, 1200, 2)
    steady = planted_drives([{}], cars=1, seconds=12.0, action=action)[0]
    found = check_commands(steady)
    assert (found.first, found.notes) == ([], [])


def with_rest(recording, rows):
    action = recording.data[keys.ACTION].clone()
    action[rows, 0] = -1.0
    return changed(recording, action)


def test_a_car_that_is_pushed_is_refused_by_name_with_row_and_value(drives):
    one, other = drives["nothing"]
    pushed = replace(with_rest(one, slice(None)), name="by_hand")
    words = r"drive by_hand: from 0\.0 to 16\.\d s the car gains \d\.\d m/s with the throttle at"
    with pytest.raises(ValueError, match=words):
        check_commands([pushed, other])


def test_a_car_that_is_carried_back_in_the_midst_is_noted_and_coasting_is_not():
    action = commands(1, 2200)
    action[:, 400:700, 0] = -1.0
    action[:, 1000:1300, 0] = -1.0
    [[recording]] = planted_drives([{}], cars=1, seconds=22.0, action=action)
    assert check_commands([recording]).notes == []
    # As if nobody had driven it from where it stands still, at 7 s, on.
    [note] = check_commands([with_rest(recording, slice(400, 1300))]).notes
    assert "from 4.0 to 13.0 s the car gains" in note


def test_the_answer_begins_with_it(drives, monkeypatch):
    config = DiagnosisConfig(
        simulator="single_track",
        recordings=["made in the test"],
        output="nowhere",
        effects=["throttle_gain"],
        parameters=False,
        stretches=12,
        minutes=10.0,  # of which the shortest search is made, since they do not predict the motion
        workers=1,
    )
    monkeypatch.setattr(pipeline, "other_sensors", lambda _: [])
    answer = pipeline.run_diagnosis(config, exchanged(drives["nothing"])).answer
    assert answer.lines()[0].startswith("The commands do not predict the motion")
    assert answer.verdict == "cannot_tell"
    assert answer.to_dict()["summary"][0] == answer.lines()[0]


def test_parts_too_short_are_left_out():
    recording = planted_drives([{}], cars=1, seconds=4.0)[0][0]
    short = Recording("short", recording.data[:20], recording.dt)
    assert check_commands([recording, short]).first == []
    assert yaw_response([short]) is None
