"""The histogram of the loop's times."""

import math

import pytest

from buggy_rl.car.loop import LoopTimes


def counted(*durations):
    times = LoopTimes()
    for seconds in durations:
        times.add(seconds)
    return times


def test_quantiles_are_right_to_a_bin():
    times = counted(*(k * 1e-4 for k in range(1, 101)))  # 0.1 ms to 10 ms
    assert times.quantile(0.5) == pytest.approx(5e-3, abs=2e-5)
    assert times.quantile(0.99) == pytest.approx(9.9e-3, abs=2e-5)
    assert times.quantile(1.0) == times.longest == pytest.approx(1e-2)


def test_a_quantile_is_never_above_the_longest():
    assert counted(1.234e-3).quantile(0.5) == 1.234e-3


def test_a_step_longer_than_the_histogram_counts_as_the_longest():
    assert counted(1e-3, 1e-3, 0.7).quantile(0.99) == 0.7


def test_without_steps_there_is_no_quantile():
    assert math.isnan(LoopTimes().quantile(0.5))
