"""Deadlines are absolute."""

import pytest

from buggy_rl.car.clock import Deadlines


class Clock:
    """Time that passes while one sleeps or works."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def starts(work):
    """When each step began, and the deadlines, for steps that take so long [s]."""
    clock = Clock()
    deadlines = Deadlines(0.01, clock, clock.sleep)
    begun = []
    for seconds in work:
        deadlines.wait()
        begun.append(clock.now)
        clock.now += seconds
    return begun, deadlines


def test_a_late_step_does_not_delay_those_after_it():
    begun, deadlines = starts([0.002, 0.025, 0.002, 0.002, 0.002])
    # Step 1 ends at 0.035: steps 2 (due 0.02) and 3 (0.03) begin late, step 4 on time.
    assert begun == pytest.approx([0.0, 0.01, 0.035, 0.037, 0.04])
    assert deadlines.overruns == 1  # only step 2 is a whole period late
    assert deadlines.slipped == 0.0


def test_quick_steps_never_overrun():
    begun, deadlines = starts([0.009] * 100)
    assert begun[-1] == pytest.approx(0.99)
    assert deadlines.overruns == 0


def test_what_cannot_be_caught_up_is_given_up_and_counted():
    _, deadlines = starts([0.0, 0.5, 0.0, 0.0])
    assert deadlines.slipped == pytest.approx(0.49)  # step 2 was due at 0.02, began at 0.51 - 0.01


def test_a_period_must_be_above_zero():
    with pytest.raises(ValueError, match="dt=0"):
        Deadlines(0.0)
