"""Keys and sticks become commands; silence is neutral."""

import json

import pytest

from buggy_rl.car.human import (
    Controls,
    HumanConfig,
    HumanInput,
    read_controls,
    toward,
    without_dead_zone,
)
from buggy_rl.car.interfaces import NEUTRAL
from buggy_rl.policies import people as command_line

DT = 0.01


class Clock:
    """Time that passes when it is told to."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def driven(controls, steps, config=None):
    """Commands of `steps` steps in which the same controls are held."""
    clock = Clock()
    human = HumanInput(config, clock)
    commands = []
    for _ in range(steps):
        human.hear(controls)
        commands.append(human.command(DT))
        clock.now += DT
    return commands


def test_before_anything_is_heard_it_is_neutral():
    assert HumanInput(clock=Clock()).command(DT) == NEUTRAL == (-1.0, 0.0)


def test_keys_are_ramped_at_the_rates_of_the_config():
    config = HumanConfig(throttle_rise=2.0, steering_rise=5.0, top_throttle=0.5)
    commands = driven(Controls(throttle=1.0, steering=1.0), 100, config)
    # 2 /s and 5 /s in steps of 0.01 s: -1 + 0.02 and 0.05 after the first one.
    assert commands[0] == pytest.approx((-0.98, 0.05))
    assert commands[9] == pytest.approx((-0.8, 0.5))
    assert commands[-1] == pytest.approx((0.5, 1.0))  # as far as keys go


def test_the_left_key_steers_to_the_left_which_is_positive_and_the_right_key_mirrors_it():
    left = driven(Controls(steering=1.0), 20)
    right = driven(Controls(steering=-1.0), 20)
    assert left[-1][1] > 0.5
    assert [(t, -s) for t, s in right] == left


def test_released_keys_fall_back_to_neutral():
    clock = Clock()
    human = HumanInput(HumanConfig(), clock)
    for held in [Controls(throttle=1.0, steering=-1.0)] * 30 + [Controls()] * 50:
        human.hear(held)
        command = human.command(DT)
        clock.now += DT
    assert command == NEUTRAL


def test_the_neutral_key_has_no_ramp():
    clock = Clock()
    human = HumanInput(HumanConfig(), clock)
    for _ in range(50):
        human.hear(Controls(throttle=1.0, steering=1.0))
        human.command(DT)
    human.hear(Controls(throttle=1.0, steering=1.0, neutral=True))
    assert human.command(DT) == NEUTRAL


@pytest.mark.parametrize("source", ["keyboard", "gamepad"])
def test_a_tenth_of_a_second_of_silence_is_neutral_and_a_moment_of_it_is_not(source):
    clock = Clock()
    human = HumanInput(HumanConfig(), clock)
    human.hear(Controls(source, throttle=1.0, steering=1.0))
    assert human.command(DT) != NEUTRAL
    clock.now += 0.05
    assert human.command(DT) != NEUTRAL
    assert not human.silent
    clock.now += 0.05 - DT  # the step that begins now lasts to 0.1 s
    assert human.command(DT) == NEUTRAL
    assert human.silent


def test_a_page_that_says_goodbye_is_neutral_at_once():
    clock = Clock()
    human = HumanInput(HumanConfig(), clock)
    human.hear(Controls("gamepad", throttle=1.0, steering=1.0))
    human.hear(Controls("gamepad", throttle=1.0, steering=1.0, connected=False))
    assert human.command(DT) == NEUTRAL


def test_a_stick_is_taken_as_it_is_beyond_its_dead_zone():
    config = HumanConfig(dead_zone=0.2)
    assert driven(Controls("gamepad", 0.25, 0.6), 1, config) == [(0.25, pytest.approx(0.5))]
    assert driven(Controls("gamepad", 0.25, -0.2), 1, config) == [(0.25, 0.0)]


def test_the_dead_zone_is_continuous_and_keeps_the_ends():
    assert without_dead_zone(0.1000001, 0.1) == pytest.approx(0.0, abs=1e-6)
    assert without_dead_zone(-1.0, 0.1) == -1.0


def test_moving_never_overshoots():
    assert toward(0.0, 0.3, 0.2, 0.9) == 0.2
    assert toward(0.2, 0.3, 0.2, 0.9) == 0.3
    assert toward(0.3, -1.0, 0.2, 0.9) == pytest.approx(-0.6)


def test_controls_are_read_from_the_message_of_the_page():
    message = json.dumps({"source": "gamepad", "throttle": -0.5, "steering": 1, "connected": True})
    assert read_controls(message) == Controls("gamepad", -0.5, 1)


@pytest.mark.parametrize(
    ("message", "named"),
    [
        ("[1, 2]", "must be an object"),
        ('{"brake": 1}', "must be an object with some of source, throttle"),
        ('{"throttle": 1.5}', "throttle=1.5"),
        ('{"steering": NaN}', "steering=nan"),
        ('{"throttle": true}', "throttle=True"),
        ('{"throttle": "1"}', "throttle='1'"),
        ('{"source": "wheel"}', "source='wheel'"),
        ('{"neutral": 1}', "neutral=1"),
        ("{", "property name"),
    ],
)
def test_other_messages_are_refused(message, named):
    with pytest.raises(ValueError, match=named.replace("[", r"\[")):
        read_controls(message)


@pytest.mark.parametrize(
    ("field", "value"),
    [("silence", 0.5), ("lock", 0.0), ("top_throttle", -1.0), ("steering_rise", 0.0),
     ("dead_zone", 1.0)],
)  # fmt: skip
def test_a_config_that_could_not_drive_is_refused(field, value):
    with pytest.raises(ValueError, match=f"human.{field}="):
        HumanInput(HumanConfig(**{field: value}))
    with pytest.raises(ValueError, match=f"human.{field}="):
        command_line.HumanConfig(**{field: value})


def test_the_command_line_has_the_defaults_of_the_car():
    assert vars(command_line.HumanConfig()) == HumanConfig()._asdict()
