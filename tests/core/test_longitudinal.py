"""What the first command is."""

import pytest

from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import LongitudinalCommand, command_of, declared_by, drive_of
from buggy_rl.simulators import make_engine

TWO_WAY = ["throttle_brake_reverse", "current", {"kind": "speed", "reverse": True}]


@pytest.mark.parametrize("command", TWO_WAY)
def test_a_command_with_reverse_is_at_rest_in_the_middle(command):
    two_way = LongitudinalCommand.of(command)
    assert two_way.two_way
    assert two_way.rest == 0.0
    assert LongitudinalCommand.of(two_way.plain) == two_way


@pytest.mark.parametrize("command", ["throttle", "speed"])
def test_one_without_is_at_rest_at_its_end(command):
    one_way = LongitudinalCommand.of(command)
    assert not one_way.two_way
    assert one_way.rest == -1.0
    assert one_way.plain == command


def test_a_drive_goes_from_rest_to_full():
    # One-way: -1, 0, 1 are no drive, half, full; two-way: full reverse, none, full.
    assert [drive_of(u, -1.0) for u in (-1.0, 0.0, 1.0)] == [0.0, 0.5, 1.0]
    assert [drive_of(u, 0.0) for u in (-1.0, 0.0, 1.0)] == [-1.0, 0.0, 1.0]
    for rest in (-1.0, 0.0):
        assert command_of(drive_of(0.25, rest), rest) == 0.25


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"kind": "clutch"}, "must be one of throttle, throttle_brake_reverse, speed, current"),
        ({"kind": "throttle", "reverse": True}, "write kind: throttle_brake_reverse"),
        ({"kind": "current", "full_speed": 3.0}, "only a speed command has a full_speed"),
        ({"kind": "speed", "gears": 2}, "gears"),
    ],
)
def test_what_makes_no_sense_is_refused_with_what_to_do(fields, words):
    with pytest.raises(ValueError, match=words):
        LongitudinalCommand.of(fields)


def test_a_simulator_that_does_not_say_takes_a_one_way_throttle():
    assert declared_by(object()) == LongitudinalCommand()
    assert declared_by(make_engine("kinematic", command="current")).kind == "current"


def test_a_car_s_file_declares_it(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(
        "dimensions: {mass: 3.0, wheelbase: 0.25}\ndrive: all\n"
        "command: {kind: throttle_brake_reverse}\n"
    )
    assert load_car(str(file)).command.two_way
    for name in ("single_track", "kinematic", "mujoco"):
        engine = make_engine(name, car=str(file))
        assert engine.command.kind == "throttle_brake_reverse"
        assert engine.values["brake_front_share"] == 0.5  # the motor brakes both axles
