"""The joystick of viewer and car: commands, the button, the cable that is pulled."""

import sys

import pytest

from buggy_rl.car.human import HumanConfig
from buggy_rl.car.interfaces import NEUTRAL
from buggy_rl.car.joystick import Joystick, JoystickInput
from tests.car.fake_pygame import FakePygame

DT = 0.01


@pytest.fixture
def pygame(monkeypatch):
    fake = FakePygame()
    monkeypatch.setitem(sys.modules, "pygame", fake)
    return fake


def test_stick_to_the_left_is_positive_and_the_trigger_drives(pygame):
    stick = JoystickInput(HumanConfig(dead_zone=0.2))
    pygame.move(0, -0.6)  # SDL: left is negative
    pygame.move(5, 0.25)
    assert stick.command(DT) == (0.25, pytest.approx(0.5))  # (0.6 - 0.2) / 0.8
    pygame.move(0, 0.1)
    assert stick.command(DT)[1] == 0.0


def test_a_trigger_that_has_not_moved_is_no_drive(pygame):
    assert JoystickInput().command(DT) == NEUTRAL


def test_an_unplugged_joystick_is_neutral_and_one_plugged_in_again_is_used(pygame):
    stick = JoystickInput()
    pygame.move(5, 1.0)
    assert stick.command(DT)[0] == 1.0
    pygame.plug(False)
    assert stick.command(DT) == NEUTRAL
    pygame.plug(True)
    assert stick.command(DT) == NEUTRAL  # its trigger has not moved yet
    pygame.move(5, -0.5)
    assert stick.command(DT)[0] == -0.5


def test_the_policy_drives_until_a_person_pulls_or_turns(pygame):
    pilot = Joystick.from_dict({})
    assert pilot.command(DT) is None
    pygame.move(5, -1.0)  # released
    assert pilot.command(DT) is None
    pygame.move(5, -0.5)
    assert pilot.command(DT) == (-0.5, 0.0)
    pygame.move(5, -1.0)
    pygame.move(0, 1.0)
    assert pilot.command(DT) == (-1.0, -1.0)


def test_the_button_must_be_held_and_the_joystick_there(pygame):
    pilot = Joystick.from_dict({"hold_button": 7})
    assert not pilot.hold_to_drive
    pygame.buttons[7] = 1
    assert pilot.hold_to_drive
    pygame.plugged = False
    assert not pilot.hold_to_drive


def test_closed_twice_it_is_let_go_once(pygame):
    pilot = Joystick.from_dict({})
    pygame.buttons[4] = 1
    pilot.close()
    pilot.close()
    assert pygame.ended
    assert not pilot.hold_to_drive


def test_without_pygame_or_joystick_the_error_says_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ValueError, match="needs pygame: pip install pygame"):
        JoystickInput()
    monkeypatch.setitem(sys.modules, "pygame", FakePygame(plugged=False))
    with pytest.raises(ValueError, match="plug one in"):
        JoystickInput()


def test_a_setting_out_of_range_is_named(pygame):
    with pytest.raises(ValueError, match=r"pilot\.hold_button=99: must be in \[0, 31\]"):
        Joystick.from_dict({"hold_button": 99})
