"""What each fault makes of a reading, and that it ends."""

import math

import pytest

from buggy_rl.car.interfaces import Reading
from buggy_rl.simulated_car.server import SENSOR_FAULTS, SensorChannel


def reading(k):
    """Number k of a car that drives at 1 m/s; each differs from the others."""
    return Reading(0.01 * k, (0.01 * k, 0.0, 0.0), (1.0, 1e-3 * k, 0.0), 1.0)


def spoilt(kind, size=0.0, count=30):
    """What arrives of readings 50 to 50 + count, after 50 good ones."""
    channel = SensorChannel()
    for k in range(50):
        assert channel.passed(reading(k)) == (reading(k), True)
    channel.spoil(kind, until=10.0, size=size)
    return [channel.passed(reading(k)) for k in range(50, 50 + count)]


def test_a_silent_sensor_gives_nothing():
    assert spoilt("silent") == [(None, False)] * 30


def test_a_frozen_one_repeats_its_numbers_with_new_stamps():
    for k, (seen, sound) in enumerate(spoilt("frozen"), 50):
        assert seen == reading(49)._replace(stamp=reading(k).stamp)
        assert not sound


@pytest.mark.parametrize("size", [0.2, 2.0])
def test_a_jumping_one_is_off_by_its_size(size):
    for k, (seen, _) in enumerate(spoilt("jumping", size), 50):
        x, y, _ = seen.pose
        assert math.hypot(x - reading(k).pose[0], y) == pytest.approx(size)


def test_a_sparse_one_gives_8_hz():
    arrived = [seen.stamp for seen, _ in spoilt("sparse", count=60) if seen]
    assert arrived == pytest.approx([0.61, 0.73, 0.85, 0.97, 1.09])


def test_a_late_one_gives_what_was_150_ms_ago():
    for k, (seen, _) in enumerate(spoilt("late"), 50):
        assert seen == reading(k - 15)


@pytest.mark.parametrize("step", [-1.0, 0.5])
def test_a_step_of_its_clock_moves_the_stamps_alone(step):
    for k, (seen, _) in enumerate(spoilt("clock_step", step), 50):
        assert seen == reading(k)._replace(stamp=reading(k).stamp + step)


def test_every_second_stamp_runs_back_by_30_ms():
    stamps = [seen.stamp for seen, _ in spoilt("stamps_back", count=4)]
    assert stamps == pytest.approx([0.47, 0.51, 0.49, 0.53])


def test_a_velocity_freezes_while_the_pose_lives():
    for k, (seen, _) in enumerate(spoilt("velocity_frozen"), 50):
        assert seen == reading(k)._replace(velocity=reading(49).velocity)


def test_a_pose_drifts_by_its_size_a_second():
    seen, _ = spoilt("pose_drifting", 0.4, count=20)[-1]
    assert seen.pose[0] - reading(69).pose[0] == pytest.approx(0.4 * 0.2)
    assert seen.velocity == reading(69).velocity


def test_the_others_spoil_a_number_and_the_confidence():
    assert all(math.isnan(seen.velocity[0]) for seen, _ in spoilt("not_a_number"))
    assert all(seen.confidence == 0.3 for seen, _ in spoilt("unsure"))


@pytest.mark.parametrize("kind", SENSOR_FAULTS)
def test_a_fault_ends_at_its_time(kind):
    channel = SensorChannel()
    channel.passed(reading(0))
    channel.spoil(kind, until=0.05, size=1.0)
    after = [channel.passed(reading(k)) for k in range(1, 10)]
    assert [sound for _, sound in after] == [False] * 5 + [True] * 4


def test_an_unknown_fault_is_refused_with_those_there_are():
    channel = SensorChannel()
    channel.passed(reading(0))
    with pytest.raises(ValueError, match=r"fault 'deaf': must be one of silent, frozen"):
        channel.spoil("deaf", 1.0)
