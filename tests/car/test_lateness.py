"""A process that is never silent for 0.1 s and is too slow nevertheless."""

import math

import pytest

from buggy_rl.car.clock import Lateness
from buggy_rl.car.guard import Guard, GuardTimes
from buggy_rl.car.interfaces import NEUTRAL
from buggy_rl.car.messages import GOOD, LATE, CommandMessage
from tests.car.test_guard import DRIVE, Board


def commanded(stamps, until):
    """The guard under commands of these stamps [s], in steps of 1 ms; when it made neutral."""
    board, commands = Board(), list(enumerate(stamps, 1))
    guard = Guard(board, GuardTimes(), 0.0)
    for step in range(round(1000 * until)):
        now = 0.001 * step
        while commands and commands[0][1] <= now:
            number, stamp = commands.pop(0)
            guard.hear(CommandMessage(number, stamp, *DRIVE), now)
        guard.act(now)
        if guard.state != GOOD:
            return now, guard.state
    assert board.taken[-1] == DRIVE
    return math.inf, guard.state


def at(*rates):
    """Stamps of (seconds, Hz) one after the other."""
    stamps = [0.0]
    for seconds, rate in rates:
        stamps += [stamps[-1] + (k + 1) / rate for k in range(round(seconds * rate))]
    return stamps


def stuttering(stopped, runs, times=6):
    """A loop at 100 Hz from 0 to 1 s, then stopped and running again and again."""
    stamps, now = at((1.0, 100)), 1.0
    for _ in range(times):
        now += stopped
        # Awake again it makes the steps that it missed at once.
        stamps += [now + 2e-4 * k for k in range(round(100 * stopped))]
        stamps += [now + 0.01 * k for k in range(1, round(100 * runs) + 1)]
        now += runs
    return stamps


@pytest.mark.parametrize("rate", [25.0, 28.0])
def test_a_loop_of_25_hz_is_neutral_within_150_ms(rate):
    when, state = commanded(at((1.0, 100), (1.0, rate)), 2.0)
    assert state == LATE
    assert 1.05 < when < 1.15


@pytest.mark.parametrize("rate", [45.0, 60.0, 90.0, 100.0])
def test_a_loop_that_keeps_up_45_hz_drives_on(rate):
    assert commanded(at((1.0, 100), (3.0, rate)), 3.9)[1] == GOOD


@pytest.mark.parametrize(("stopped", "runs"), [(0.08, 0.02), (0.08, 0.03), (0.06, 0.01)])
def test_a_loop_that_is_stopped_again_and_again_is_neutral_within_150_ms(stopped, runs):
    when, state = commanded(stuttering(stopped, runs), 2.0)
    assert state == LATE
    assert 1.05 < when < 1.15


@pytest.mark.parametrize("stopped", [0.03, 0.06, 0.095])
def test_a_single_stall_below_100_ms_changes_nothing(stopped):
    assert commanded([*stuttering(stopped, 1.0, times=1)], 1.9)[1] == GOOD


def test_a_loop_that_was_too_slow_drives_again_after_it_commanded_neutral():
    board, now, number = Board(), 0.0, 0
    guard = Guard(board, GuardTimes(), 0.0)
    for seconds, period, pair in [(0.4, 0.04, DRIVE), (0.2, 0.01, NEUTRAL), (0.2, 0.01, DRIVE)]:
        for _ in range(round(seconds / period)):
            now, number = now + period, number + 1
            guard.act(now - 0.001)
            guard.hear(CommandMessage(number, now, *pair), now)
            guard.act(now)
        if pair == DRIVE and period > 0.01:
            assert guard.state == LATE
            assert board.taken[-1] == NEUTRAL
    assert guard.state == GOOD
    assert board.taken[-1] == DRIVE


def test_its_patience_is_the_gap_from_which_it_is_too_slow():
    late = Lateness(0.01)
    assert late.patience() == math.inf
    for _ in range(2):
        late.add(0.04)
    assert 0.02 < late.patience() < 0.06
    assert not late.too_slow(late.patience() - 1e-6)
    assert late.too_slow(late.patience() + 1e-6)
