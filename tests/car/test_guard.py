"""The watchdog's rule, by a clock that the test moves."""

import math

import pytest

from buggy_rl.car.guard import Guard, GuardTimes
from buggy_rl.car.interfaces import NEUTRAL, Actuator
from buggy_rl.car.messages import FAILING, GOOD, READ_BACK, SILENT, TAKEN, CommandMessage

DRIVE = (0.2, -0.4)


class Board(Actuator):
    """Keeps what it took; refuses while it is told to."""

    def __init__(self):
        self.taken, self.refuses = [], False

    def write(self, throttle, steering):
        if self.refuses:
            raise OSError("no acknowledgement")
        self.taken.append((throttle, steering))


class Watched:
    """A guard in steps of 1 ms, and the times [s] of its writes."""

    def __init__(self):
        self.board, self.now, self.sequence = Board(), 5.0, 0
        self.guard = Guard(self.board, GuardTimes(), self.now)

    def command(self, pair, age=0.0, sequence=None):
        self.sequence += 1
        number = self.sequence if sequence is None else sequence
        self.guard.hear(CommandMessage(number, self.now - age, *pair), self.now)

    def run(self, seconds, pair=None):
        """Commands `pair` every 10 ms, if there is one."""
        for step in range(round(seconds / 0.001)):
            if pair is not None and step % 10 == 0:
                self.command(pair)
            self.guard.act(self.now)
            self.now += 0.001
        return self


def test_fresh_commands_are_written_once_each():
    watched = Watched().run(0.1, DRIVE)
    assert watched.board.taken[-10:] == [DRIVE] * 10
    assert watched.guard.state == GOOD


def test_100_ms_without_a_fresh_command_are_neutral_which_is_kept_being_written():
    watched = Watched().run(0.05, DRIVE)
    last_heard = watched.now - 0.01
    watched.run(0.3)
    first = watched.board.taken.index(NEUTRAL, 1)
    assert watched.guard.state == SILENT
    assert len(watched.board.taken) - first > 15  # every 10 ms for 0.2 s
    assert watched.now - last_heard > 0.3


@pytest.mark.parametrize(("silence", "acts"), [(0.095, DRIVE), (0.112, NEUTRAL)])
def test_the_timeout_is_100_ms(silence, acts):
    watched = Watched().run(0.02, DRIVE)  # the last command came 10 ms before the end
    assert watched.run(silence - 0.01).board.taken[-1] == acts


@pytest.mark.parametrize(
    "change",
    [
        {"age": 0.2},
        {"sequence": 1},
        {"pair": (math.nan, 0.0)},
        {"pair": (3.0, 0.0)},
        {"age": math.nan},
    ],
    ids=str,
)
def test_an_old_repeated_or_impossible_command_counts_as_none(change):
    watched = Watched().run(0.05, DRIVE)
    for _ in range(20):
        watched.command(**{"pair": (0.9, 0.9), **change})
        watched.run(0.01)
    assert watched.board.taken[-1] == NEUTRAL
    assert all(taken[0] < 0.9 for taken in watched.board.taken)


def test_after_a_silence_drive_is_not_taken_before_neutral_was_commanded():
    watched = Watched().run(0.05, DRIVE).run(0.2).run(0.1, DRIVE)
    assert watched.board.taken[-1] == NEUTRAL
    watched.run(0.02, NEUTRAL)
    assert watched.guard.state == GOOD
    assert watched.run(0.05, DRIVE).board.taken[-1] == DRIVE


def test_a_refused_write_is_retried_within_milliseconds_as_neutral():
    watched = Watched().run(0.05, DRIVE)
    watched.board.refuses = True
    watched.run(0.03, DRIVE)
    assert watched.guard.state == FAILING
    watched.board.refuses, before = False, len(watched.board.taken)
    watched.run(0.004)
    assert watched.board.taken[before:] == [NEUTRAL]


def test_after_a_refusal_drive_is_not_taken_before_neutral_was_commanded():
    watched = Watched().run(0.05, DRIVE)
    watched.board.refuses = True
    watched.run(0.02, DRIVE)
    watched.board.refuses = False
    assert watched.run(0.05, DRIVE).board.taken[-1] == NEUTRAL
    assert watched.run(0.02, NEUTRAL).run(0.02, DRIVE).board.taken[-1] == DRIVE


def test_a_report_says_what_was_written_and_whether_it_was_taken():
    watched = Watched().run(0.01, DRIVE)
    watched.command((0.1, 0.2))
    pair, taken = watched.guard.act(watched.now)
    assert (pair, taken) == ((0.1, 0.2), True)
    report = watched.guard.report(7.0, pair, taken)
    assert report == (watched.sequence, 7.0, 0.1, 0.2, 1, GOOD)


def test_silence_is_neutral_with_the_next_write():
    watched = Watched().run(0.05, DRIVE)
    watched.guard.silence()
    assert watched.run(0.001).board.taken[-1] == NEUTRAL


def test_it_waits_no_longer_than_something_is_due():
    watched = Watched().run(0.01, DRIVE)  # heard 10 ms ago
    assert watched.guard.wait(watched.now) == pytest.approx(0.09)
    watched.run(0.2)
    assert watched.guard.wait(watched.now) <= 0.01


class Losing(Board):
    """Says that it takes a command, and does not, while it is told to; can be read."""

    def __init__(self):
        super().__init__()
        self.loses, self.held, self.looks = False, NEUTRAL, 0

    def write(self, throttle, steering):
        super().write(throttle, steering)
        if not self.loses:
            self.held = throttle, steering

    def holds(self, throttle, steering):
        self.looks += 1
        return self.held == (throttle, steering)


def losing():
    watched = Watched()
    watched.board = Losing()
    watched.guard = Guard(watched.board, GuardTimes(), watched.now)
    return watched


def test_a_stop_counts_only_when_the_board_holds_it():
    watched = losing().run(0.05, DRIVE)
    watched.board.loses = True
    watched.run(0.02, NEUTRAL)
    assert watched.guard.state == FAILING
    watched.board.loses = False
    watched.run(0.004)
    assert watched.board.held == NEUTRAL
    watched.run(0.02, NEUTRAL)
    assert watched.guard.state == GOOD


def test_a_board_that_loses_commands_is_noticed_while_it_is_driven():
    watched = losing().run(0.2, DRIVE)
    watched.board.loses = True
    watched.run(0.06, (0.3, 0.0))
    assert watched.guard.state == FAILING


def test_a_board_is_read_at_each_new_neutral_and_now_and_then():
    watched = losing().run(0.01)
    assert watched.board.looks == 1  # the first neutral
    watched.run(1.0, DRIVE)
    assert 15 <= watched.board.looks <= 22  # every 50 ms
    before = watched.board.looks
    watched.run(1.0, NEUTRAL)
    assert watched.board.looks == before + 1


@pytest.mark.parametrize(("made", "done"), [(losing, READ_BACK), (Watched, TAKEN)])
def test_a_report_says_whether_the_last_neutral_was_read_back(made, done):
    watched = made().run(0.05, DRIVE)
    watched.guard.silence(7)
    assert watched.guard.act(watched.now) == (NEUTRAL, done)
    assert watched.guard.sequence == 7
