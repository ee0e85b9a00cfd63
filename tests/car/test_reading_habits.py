"""Sensors that lie in every second reading, or in one number."""

import itertools
import math

import pytest

from tests.car.motion import Drive, reading
from tests.car.test_supervisor import neutral, no_drive


def noisy(stamp, **changes):
    """A tracking camera's: every number is a little off, differently each time."""
    wave = [1e-3 * math.sin(1e4 * stamp + k) for k in range(3)]
    made = reading(stamp)
    pose = (made.pose[0] + 0.2 * wave[0], 0.2 * wave[1], wave[2])
    velocity = (1.0 + wave[0], wave[1], wave[2])
    return made._replace(pose=pose, velocity=velocity)._replace(**changes)


def armed_by(readings):
    """A car that was driven by these readings for a second."""
    drive = Drive()
    drive.run(0.5, readings)
    drive.hold = True
    drive.run(1.0, readings)
    assert drive.last.source == "policy"
    return drive


def every(count, bad):
    """One reading of so many is bad."""
    numbers = itertools.count(1)
    return lambda stamp: [bad(stamp) if next(numbers) % count == 0 else noisy(stamp)]


LIES = {
    "30 ms back": lambda stamp: noisy(stamp)._replace(stamp=stamp - 0.03),
    "not a number": lambda stamp: noisy(stamp, velocity=(math.nan, 0.0, 0.0)),
    "half a metre off": lambda stamp: noisy(stamp, pose=(stamp + 0.5, 0.0, 0.0)),
    "unsure": lambda stamp: noisy(stamp, confidence=0.3),
}


@pytest.mark.parametrize("count", [2, 3])
@pytest.mark.parametrize("lie", LIES)
def test_a_sensor_of_which_every_second_or_third_reading_is_bad_cuts_the_drive(lie, count):
    drive = armed_by(lambda stamp: [noisy(stamp)])
    begin = len(drive.decisions)
    drive.run(0.6, every(count, LIES[lie]))
    assert drive.seconds_until(no_drive, begin) <= 0.14
    assert drive.seconds_until(neutral, begin) <= 0.35
    assert not drive.last.armed


def test_a_bad_reading_now_and_then_changes_nothing():
    drive = armed_by(lambda stamp: [noisy(stamp)])
    begin = len(drive.decisions)
    drive.run(2.0, every(10, LIES["not a number"]))
    assert not any(map(no_drive, drive.decisions[begin:]))


def test_a_reading_that_comes_twice_is_no_fault():
    """A driver that keeps the last frame of a camera at 50 Hz."""
    last = {}

    def doubled(stamp):
        frame = math.floor(stamp / 0.02)
        last.setdefault(frame, noisy(stamp))
        return [last[frame]]

    drive = armed_by(doubled)
    begin = len(drive.decisions)
    drive.run(2.0, doubled)
    assert not any(map(no_drive, drive.decisions[begin:]))


@pytest.mark.parametrize("index", [None, 0, 2], ids=["all", "vx", "yaw_rate"])
def test_a_velocity_that_froze_while_the_pose_lives_cuts_the_drive(index):
    drive = armed_by(lambda stamp: [noisy(stamp)])
    begin, held = len(drive.decisions), noisy(drive.now).velocity

    def frozen(stamp):
        made = noisy(stamp)
        parts = [held[k] if index in (None, k) else made.velocity[k] for k in range(3)]
        return [made._replace(velocity=tuple(parts))]

    drive.run(0.5, frozen)
    assert drive.seconds_until(no_drive, begin) <= 0.1
    assert not drive.last.armed
    assert "frozen" in drive.message


def test_odometry_in_steps_is_no_frozen_one():
    """Its velocity is rounded to 0.2 m/s, and of vy and yaw rate it knows nothing."""

    def stepped(stamp):
        return [noisy(stamp, velocity=(round(5 * (1 + 0.02 * math.sin(stamp))) / 5, 0.0, 0.0))]

    drive = armed_by(stepped)
    begin = len(drive.decisions)
    drive.run(3.0, stepped)
    assert not any(map(no_drive, drive.decisions[begin:]))


def test_a_filter_that_gives_0_for_a_car_that_stands_can_be_armed_by():
    drive = armed_by(lambda stamp: [noisy(stamp)])
    end = drive.now

    def standing(stamp):
        moved = noisy(stamp)
        return [moved._replace(pose=(end + moved.pose[0] - stamp, *moved.pose[1:]),
                               velocity=(0.0, 0.0, 0.0))]  # fmt: skip

    drive.run(0.5, standing)
    drive.hold = False
    drive.run(0.3, standing)
    drive.hold = True
    drive.run(0.05, standing)
    assert drive.last.armed


def test_a_velocity_that_freezes_again_and_again_stays_a_fault():
    """A fault that a person has cleared several times is not taken for the sensor's habit."""
    drive = armed_by(lambda stamp: [noisy(stamp)])
    for _ in range(8):
        held = noisy(drive.now).velocity
        drive.run(0.3, lambda stamp, held=held: [noisy(stamp, velocity=held)])
        assert "frozen" in drive.message
        drive.hold = False
        drive.run(0.7, lambda stamp: [noisy(stamp)])
        drive.hold = True
        drive.run(0.7, lambda stamp: [noisy(stamp)])
        assert drive.last.source == "policy"
