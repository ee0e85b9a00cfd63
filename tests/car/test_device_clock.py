"""A device's stamps on the monotonic clock: even where arrival is not; safe where clocks step."""

import math
import random
from itertools import pairwise

import pytest

from buggy_rl.car.clock import DeviceClock

PERIOD, FASTEST = 0.005, 0.002  # [s] of frames, and of the way here


def frames(count, offset=1000.0, first=0, seed=0):
    """(device stamp, arrival, time it was measured by the monotonic clock) of late frames."""
    late = random.Random(seed)
    for index in range(first, first + count):
        true = PERIOD * index
        yield true - offset, true + FASTEST + late.expovariate(500), true


def test_times_are_even_although_frames_arrive_late():
    clock = DeviceClock()
    seen = [(clock.time(stamp, arrival), true) for stamp, arrival, true in frames(2000)]
    settled = seen[200:]
    for time, true in settled:
        assert 0 < time - true - FASTEST < 0.0002
    steps = [b[0] - a[0] for a, b in pairwise(settled)]
    assert max(steps) - min(steps) < 0.0002


def test_no_frame_is_measured_after_it_arrived():
    clock = DeviceClock()
    assert all(clock.time(stamp, arrival) <= arrival + 1e-9 for stamp, arrival, _ in frames(500))


def test_a_clock_that_steps_ahead_is_followed_at_once():
    clock = DeviceClock()
    for stamp, arrival, _ in frames(300):
        clock.time(stamp, arrival)
    for stamp, arrival, true in frames(300, offset=900.0, first=300):
        assert true <= clock.time(stamp, arrival) <= arrival + 1e-9


def test_a_clock_that_steps_back_makes_readings_old_and_then_right_again():
    clock = DeviceClock(frames=100)
    for stamp, arrival, _ in frames(300):
        clock.time(stamp, arrival)
    after = list(frames(200, offset=1003.0, first=300))
    ages = [arrival - clock.time(stamp, arrival) for stamp, arrival, _ in after]
    assert ages[0] == pytest.approx(3.0, abs=0.05)  # as old as the step: the car stops
    assert max(ages[100:]) < 0.05


def test_a_stamp_that_is_none_is_passed_on_and_spoils_nothing():
    clock = DeviceClock()
    clock.time(1.0, 11.0)
    assert math.isnan(clock.time(math.nan, 11.005))
    assert clock.time(1.01, 11.012) == pytest.approx(11.01)
