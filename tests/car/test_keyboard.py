"""The keyboard of a terminal, on a real pseudo-terminal, with a clock of its own."""

import os
import pty
import termios

import pytest

from buggy_rl.car.human import HumanConfig
from buggy_rl.car.interfaces import NEUTRAL
from buggy_rl.car.keyboard import Keyboard

DT = 0.01
REPEAT = 3  # steps of 10 ms between repetitions of a held key, about 30 a second


class Terminal:
    """A terminal whose keys are pressed by the test."""

    def __init__(self, config=None):
        self.keys, self.end = pty.openpty()
        self.now = 50.0
        self.keyboard = Keyboard(config or HumanConfig(), self.end, lambda: self.now)

    def hold(self, key, steps):
        """Commands and the button while a key repeats."""
        seen = []
        for step in range(steps):
            if step % REPEAT == 0:
                os.write(self.keys, key.encode())
            seen.append((self.keyboard.command(DT), self.keyboard.hold_to_drive))
            self.now += DT
        return seen

    def wait(self, steps):
        """The same with no key."""
        return self.hold("", steps)


@pytest.fixture
def terminal():
    made = Terminal()
    yield made
    made.keyboard.close()
    os.close(made.keys)
    os.close(made.end)


def test_before_a_key_nobody_is_there(terminal):
    assert terminal.wait(2) == [(None, False)] * 2


def test_p_leaves_the_car_to_the_policy_while_it_repeats(terminal):
    assert terminal.hold("p", 20) == [(None, True)] * 20
    after = terminal.wait(12)
    assert after[-1] == (None, False)  # 0.08 s after the last repetition
    assert after[4][1]


@pytest.mark.parametrize(("key", "side"), [("w", 0), ("q", 1), ("e", -1), ("\x1b[A", 0)])
def test_a_drive_key_is_ramped_up_and_steers_to_its_side(terminal, key, side):
    seen = terminal.hold(key, 30)
    throttle, steering = seen[-1][0]
    assert throttle == pytest.approx(-1 + 30 * DT * 1.0)
    assert steering == pytest.approx(side)
    assert all(held for _, held in seen)


@pytest.mark.parametrize(("key", "side"), [("a", 1), ("d", -1), ("\x1b[D", 1), ("\x1b[C", -1)])
def test_a_steering_key_does_not_drive(terminal, key, side):
    throttle, steering = terminal.hold(key, 30)[-1][0]
    assert (throttle, steering) == (-1.0, side)


@pytest.mark.parametrize("key", [" ", "s", "\x1b[B", "x"])
def test_any_other_key_stops(terminal, key):
    terminal.hold("w", 30)
    assert terminal.hold(key, 1) == [(None, False)]
    assert terminal.hold("w", 1)[0][0][0] < NEUTRAL[0] + 0.02  # from no drive on


def test_the_key_of_the_brake_is_one_where_the_car_has_a_brake():
    made = Terminal(HumanConfig(two_way=True, top_throttle=0.5))
    seen = made.hold("x", 30)
    made.keyboard.close()
    assert seen[-1] == ((pytest.approx(-0.5), 0.0), True)


def test_the_terminal_is_as_it_was_after_closing(terminal):
    assert not termios.tcgetattr(terminal.end)[3] & termios.ECHO
    terminal.keyboard.close()
    terminal.keyboard.close()
    assert termios.tcgetattr(terminal.end)[3] & termios.ECHO
    assert not terminal.keyboard.hold_to_drive


def test_no_terminal_is_refused():
    reading, writing = os.pipe()
    with pytest.raises(ValueError, match="needs a terminal"):
        Keyboard(source=reading)
    os.close(reading)
    os.close(writing)
