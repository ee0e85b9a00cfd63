"""Recordings of cars with brakes and reverse."""

import numpy as np
import pytest

from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.recordings import RecordingError, load_recording
from buggy_rl.recordings.checks.commands import speed_along
from buggy_rl.recordings.columns import ColumnMap, Throttle
from buggy_rl.recordings.raw_recording import RawRecording
from buggy_rl.recordings.recording import refuse_another_rest
from buggy_rl.simulators import make_engine
from tests.recordings.test_foreign_cars import REVERSING, VELOCITY, retraced

ESC = LongitudinalCommand("throttle_brake_reverse")


def two_way(make_drive):
    """A drive with reverse in it whose command goes with the motion: u = v / 3."""
    frame = retraced(make_drive(noise=2e-4))
    yaw = np.unwrap(frame.yaw)
    vx = np.gradient(frame.x, frame.t) * np.cos(yaw) + np.gradient(frame.y, frame.t) * np.sin(yaw)
    smooth = np.convolve(vx, np.ones(21) / 21, "same")
    return frame.assign(throttle=np.clip(smooth / 3, -1, 1))


@pytest.mark.parametrize("velocity", ["measured", "derived"])
def test_reverse_is_read_in_full_where_the_command_has_it(make_drive, write, velocity):
    frame = two_way(make_drive)
    if velocity == "derived":
        frame = frame.drop(columns=VELOCITY)
    recording = load_recording(write(frame), ColumnMap(command=ESC))
    assert recording.command == ESC
    assert not [note for note in recording.notes if "reverses" in note]
    assert recording.duration == pytest.approx(16, abs=0.2)
    t, vx = recording.data["t"][:, 0], recording.data["velocity"][:, 0]
    begin, end = REVERSING
    assert (vx[(t > begin + 0.5) & (t < end - 0.5)] < 0).float().mean() > 0.9
    assert recording.data["action"][:, 0].min() < -0.2


def test_without_it_a_throttle_below_rest_in_reverse_is_refused_with_what_to_declare(
    make_drive, write
):
    path = write(two_way(make_drive))
    with pytest.raises(RecordingError, match=r"column throttle.*command: \{kind: throttle_brake"):
        load_recording(path)


def test_the_car_s_file_declares_it_as_well(make_drive, write, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("dimensions: {mass: 1.6, wheelbase: 0.17}\ncommand: {kind: current}\n")
    recording = load_recording(write(two_way(make_drive)), car=str(file))
    assert recording.command == load_car(str(file)).command
    assert recording.duration == pytest.approx(16, abs=0.2)


def test_commands_are_linear_on_either_side_of_rest(good, write):
    raw = good.assign(throttle=np.resize([1300.0, 1400.0, 1500.0, 1600.0, 1900.0], len(good)))
    columns = ColumnMap(command=ESC, throttle=Throttle(rest=1500, full=1900, lowest=1300))
    found = load_recording(write(raw), columns).data["action"][:, 0]
    assert sorted({round(float(u), 3) for u in found}) == [-1.0, -0.5, 0.0, 0.25, 1.0]


@pytest.mark.parametrize(
    ("throttle", "expected"),
    [
        (Throttle(), Throttle(0.0, 1.0, -1.0)),
        (Throttle(1500, 1900), Throttle(1500, 1900, 1100)),
        (Throttle(0.0, 5.0, -2.0), Throttle(0.0, 5.0, -2.0)),
    ],
)
def test_what_the_range_leaves_out_is_symmetrical(throttle, expected):
    assert ColumnMap(command=ESC, throttle=throttle).throttle == expected


def test_a_range_with_both_ends_on_one_side_is_refused():
    with pytest.raises(ValueError, match="on either side of rest, 0"):
        ColumnMap(command=ESC, throttle=Throttle(rest=0.0, full=1.0, lowest=0.5))


def test_a_command_beyond_its_range_is_refused(good, write):
    raw = good.assign(throttle=good.throttle.where(good.index != 500, -1.4))
    with pytest.raises(RecordingError, match=r"row 50\d.*throttle: -1.4 is outside the range"):
        load_recording(write(raw), ColumnMap(command=ESC))


@pytest.mark.parametrize(
    ("turned", "words"),
    [
        (np.pi, r"where the command is forward.*mount: \{yaw: 3.142\}"),
        (0.5 * np.pi, r"rotated: set mount: \{yaw: -?1.5[67]"),
        (None, r"other sign: set signs: \{yaw: -1\}"),
    ],
)
def test_a_wrong_yaw_is_seen_in_spite_of_reverse(make_drive, write, turned, words):
    frame = two_way(make_drive).drop(columns=VELOCITY)
    frame["yaw"] = -frame.yaw if turned is None else frame.yaw + turned
    with pytest.raises(RecordingError, match=words):
        load_recording(write(frame), ColumnMap(command=ESC))


def test_the_sign_of_the_steering_is_judged_by_the_direction_of_travel(make_drive, write):
    frame = two_way(make_drive)
    for sign, notes in ((1, 0), (-1, 1)):
        # The command that a wheel shows: yaw rate over speed, of either sign.
        yaw = np.unwrap(frame.yaw)
        rate = np.convolve(np.gradient(yaw, frame.t), np.ones(21) / 21, "same")
        curvature = rate / np.where(np.abs(frame.throttle) > 0.1, 3 * frame.throttle, np.inf)
        steered = frame.assign(steering=np.clip(sign * curvature / 1.5, -1, 1))
        found = load_recording(write(steered), ColumnMap(command=ESC)).notes
        assert len([n for n in found if "turns the car right" in n]) == notes


def test_the_speed_along_the_heading_is_negative_in_reverse():
    t, up = np.arange(5.0), np.full(5, np.pi / 2)
    pose = np.stack([np.zeros(5), -2.0 * t, up], -1)
    raw = RawRecording("mine", t, pose, None, None, np.zeros((5, 2)), np.arange(5), {})
    assert speed_along(raw).tolist() == pytest.approx([-2.0] * 5)


def test_a_simulator_that_takes_another_command_is_refused_these_recordings(make_drive, write):
    recording = load_recording(write(two_way(make_drive)), ColumnMap(command=ESC))
    refuse_another_rest([recording], make_engine("kinematic", command="current"))  # rest 0 too
    refuse_another_rest([recording], make_engine("hold"))  # it takes none
    with pytest.raises(ValueError, match="whose rest is 0; the simulator takes throttle"):
        refuse_another_rest([recording], make_engine("kinematic"))
