"""The safety rules, each as a fact about what the wheels get, with its negative control."""

import math

import pytest

from buggy_rl.car.interfaces import NEUTRAL
from buggy_rl.car.safety import RANGES, Circle, Polygon, Safety
from tests.car.motion import POLICY, Drive, reading


def no_drive(decision):
    return decision.command[0] == -1.0


def neutral(decision):
    return decision.command == NEUTRAL


def test_an_armed_car_does_what_the_policy_says():
    drive = Drive().arm()
    assert drive.last.command == pytest.approx(POLICY)
    assert drive.last.source == "policy"


def test_a_car_that_nobody_armed_stays_neutral():
    drive = Drive().run(1.0)
    assert all(map(neutral, drive.decisions))
    assert not drive.last.armed


def test_a_button_held_since_the_start_does_not_arm():
    drive = Drive()
    drive.hold = True
    assert not drive.run(1.0).last.armed


def test_releasing_the_button_is_neutral_in_the_same_step():
    drive = Drive().arm()
    drive.hold = False
    assert neutral(drive.run(0.01).last)
    assert "released" in drive.message


def test_a_press_after_a_release_arms_again():
    drive = Drive().arm()
    drive.hold = False
    drive.run(0.01)
    drive.hold = True
    assert drive.run(0.1).last.source == "policy"


def test_nothing_arms_before_readings_were_good_for_a_while():
    drive = Drive()
    drive.run(0.05)
    drive.hold = True
    assert not drive.run(0.5).last.armed
    assert "cannot arm: good readings for" in drive.message


@pytest.mark.parametrize(("throttle", "arms"), [(-1.0, True), (-0.95, True), (-0.5, False)])
def test_a_person_arms_at_neutral_only(throttle, arms):
    drive = Drive()
    drive.own = (throttle, 0.0)
    drive.run(0.2)
    drive.hold = True
    assert drive.run(0.05).last.armed == arms


def test_a_person_overrides_the_policy_and_hands_back_to_it():
    drive = Drive().arm()
    drive.own = (-0.8, -0.2)
    drive.run(0.1)
    assert drive.last.source == "person"
    assert drive.last.command == pytest.approx((-0.8, -0.2))
    drive.own = None
    assert drive.run(0.1).last.source == "policy"


def test_the_limits_bound_a_person_too():
    drive = Drive(Safety(throttle_cap=-0.4)).arm()
    drive.own = (1.0, 0.0)
    assert drive.run(0.2).last.command[0] == pytest.approx(-0.4)
    assert drive.supervisor.limits.capped > 0


BAD = {
    "silent": lambda stamp: [],
    "not a number": lambda stamp: [reading(stamp, velocity=(math.nan, 0.0, 0.0))],
    "infinite": lambda stamp: [reading(stamp, pose=(math.inf, 0.0, 0.0))],
    "unsure": lambda stamp: [reading(stamp, confidence=0.4)],
    "frozen": lambda stamp: [reading(10.4)._replace(stamp=stamp)],
    "jumped": lambda stamp: [reading(stamp, pose=(stamp + 0.3, 0.0, 0.0))],
    "turned": lambda stamp: [reading(stamp, pose=(stamp, 0.0, 0.5))],
    "too fast": lambda stamp: [reading(stamp, velocity=(16.0, 0.0, 0.0))],
    "leapt in speed": lambda stamp: [reading(stamp, velocity=(4.0, 0.0, 0.0))],
    "spinning": lambda stamp: [reading(stamp, velocity=(1.0, 0.0, 26.0))],
    "far away": lambda stamp: [reading(stamp, pose=(1e4, 0.0, 0.0))],
    "stamped ahead": lambda stamp: [reading(stamp)._replace(stamp=stamp + 1.0)],
    "stamped back": lambda stamp: [reading(stamp)._replace(stamp=stamp - 1.0)],
    "late": lambda stamp: [reading(stamp - 0.15)],
}


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_sensor_cuts_the_drive_after_50_ms_and_disarms_after_250(fault):
    drive = Drive().arm()
    begin = len(drive.decisions)
    drive.run(0.35, BAD[fault])
    # The last good reading is 2 ms older than its step; steps are 10 ms apart.
    assert 0.04 <= drive.seconds_until(no_drive, begin) <= 0.05
    assert 0.24 <= drive.seconds_until(neutral, begin) <= 0.26
    assert not drive.last.armed


def test_whatever_the_limits_a_lost_sensor_cuts_the_drive_within_150_ms():
    drive = Drive(Safety.from_dict({"coast_after": RANGES["coast_after"][1]})).arm()
    begin = len(drive.decisions)
    drive.run(0.3, BAD["silent"])
    assert 0.09 <= drive.seconds_until(no_drive, begin) <= 0.12


@pytest.mark.parametrize("size", [0.1, 0.15, 0.2, 0.3, 0.6, 2.0])
@pytest.mark.parametrize("far", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 3.0)], ids=str)
def test_a_jump_of_any_size_from_10_cm_or_17_degrees_disarms(size, far):
    drive = Drive().arm()
    offset = [size * part for part in far]
    drive.run(0.4, lambda t: [reading(t, pose=(t + offset[0], offset[1], offset[2]))])
    assert not drive.last.armed


@pytest.mark.parametrize(("measured", "armed"), [(0.8, True), (1.2, True), (0.3, False)])
def test_a_speed_that_the_position_does_not_follow_disarms(measured, armed):
    drive = Drive().arm()

    def slipping(stamp):
        return [reading(stamp, velocity=(measured, 0.0, 0.0))]

    assert drive.run(1.0, slipping).last.armed == armed


@pytest.mark.parametrize("fault", BAD)
def test_it_keeps_the_steering_while_it_coasts(fault):
    drive = Drive().arm()
    drive.run(0.15, BAD[fault])
    assert drive.last.source == "coast"
    assert drive.last.command == (-1.0, pytest.approx(POLICY[1]))


def test_a_sparse_sensor_disarms_too():
    drive, count = Drive().arm(), iter(range(1000))
    begin = len(drive.decisions)
    drive.run(0.4, lambda stamp: [] if next(count) % 12 else [reading(stamp)])
    assert 0.24 <= drive.seconds_until(neutral, begin) <= 0.30


@pytest.mark.parametrize("lost", [0.02, 0.03])
def test_a_few_lost_frames_change_nothing(lost):
    drive = Drive().arm()
    begin = len(drive.decisions)
    drive.run(lost, BAD["silent"]).run(0.3)
    assert not any(map(no_drive, drive.decisions[begin:]))


def test_a_short_loss_coasts_and_then_drives_on():
    drive = Drive().arm()
    begin = len(drive.decisions)
    drive.run(0.1, BAD["silent"]).run(0.3)
    assert any(map(no_drive, drive.decisions[begin:]))
    assert drive.last.source == "policy"


def test_a_single_leap_is_no_more_than_a_lost_frame():
    drive = Drive().arm()
    begin = len(drive.decisions)
    drive.run(0.01, BAD["jumped"]).run(0.3)
    assert not any(map(no_drive, drive.decisions[begin:]))


def test_a_standing_car_may_look_frozen_until_it_is_driven():
    def still(stamp):
        return [reading(stamp, pose=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0))]

    drive = Drive()
    drive.run(0.3, still)
    drive.hold = True
    drive.run(0.02, still)
    assert drive.last.armed
    drive.run(0.4, still)
    assert not drive.last.armed
    assert "frozen" in drive.message


def test_a_tracker_that_is_elsewhere_is_believed_after_a_disarming_only():
    def elsewhere(stamp):
        return [reading(stamp, pose=(stamp + 5.0, 0.0, 0.0))]

    drive = Drive().arm().run(0.4, elsewhere)
    assert not drive.last.armed
    drive.hold = False
    drive.run(0.2, elsewhere)
    drive.hold = True
    assert drive.run(0.1, elsewhere).last.source == "policy"


@pytest.mark.parametrize(
    "action", [(math.nan, 0.0), (0.0, math.inf), (1.5, 0.0), (0.0, -1.01)], ids=str
)
def test_an_impossible_command_disarms_in_the_same_step(action):
    drive = Drive().arm()
    drive.policy = action
    assert neutral(drive.run(0.01).last)
    assert not drive.last.armed
    assert "finite" in drive.message or "outside" in drive.message


def test_a_command_that_single_precision_rounded_does_not():
    drive = Drive().arm()
    drive.policy = (-0.5, 1.0000001)
    assert drive.run(0.1).last.command[1] == 1.0


def test_leaving_the_fence_is_neutral_at_once():
    drive = Drive(fence=Circle(10.0, 0.0, 1.0)).arm()
    drive.run(1.0)
    outside = [d for d in drive.decisions if not d.armed]
    assert neutral(drive.last)
    assert outside
    assert "outside the fence" in drive.message
    x = drive.supervisor.readings.good.pose[0]
    assert x > 11.0


def test_outside_the_fence_nothing_arms():
    drive = Drive(fence=Polygon(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))))
    drive.run(0.2)
    drive.hold = True
    assert not drive.run(0.1).last.armed


def test_trouble_at_the_actuator_disarms_and_forbids_to_arm():
    drive = Drive().arm()
    drive.hardware = "the actuator does not take commands"
    assert neutral(drive.run(0.01).last)
    drive.hold = False
    drive.run(0.1)
    drive.hold = True
    assert not drive.run(0.1).last.armed


def test_steering_and_throttle_rise_no_faster_than_the_limits():
    drive = Drive(Safety(steering_rate=5.0, throttle_rise=2.0)).arm()
    drive.policy = (0.0, -1.0)
    before = drive.last.command
    after = drive.run(0.01).last.command
    assert before[1] - after[1] == pytest.approx(0.05)
    assert after[0] - before[0] == pytest.approx(0.02)


def test_the_throttle_falls_at_once():
    drive = Drive(Safety(throttle_rise=2.0)).arm()
    drive.policy = (-1.0, 0.0)
    assert drive.run(0.01).last.command[0] == -1.0


def test_without_a_policy_an_armed_car_stands():
    drive = Drive()
    drive.policy = None
    drive.arm()
    assert neutral(drive.last)
