"""Trial commands of a simulator's preflight, whatever its first command is."""

import pytest
import torch

from buggy_rl.diagnosis.preflight.simulator import _commands, check_simulator
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.contract import gentle

TWO_WAY = ["throttle_brake_reverse", "current", {"kind": "speed", "reverse": True}]


def test_those_of_a_one_way_throttle_are_what_they_were():
    car = make_engine("single_track", 5)
    expected = [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]
    assert _commands(car).tolist() == expected
    assert gentle(car)[0].tolist() == [-0.5, 0.0]


@pytest.mark.parametrize("command", TWO_WAY, ids=str)
def test_a_car_that_can_reverse_is_driven_gently_forward_and_braked_in_full(command):
    car = make_engine("single_track", 5, command=command)
    expected = [[0.5, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.5, 1.0], [0.5, -1.0]]
    assert torch.equal(_commands(car), torch.tensor(expected))
    assert gentle(car)[0].tolist() == [0.25, 0.0]


@pytest.mark.parametrize("command", ["throttle", *TWO_WAY], ids=str)
def test_such_simulators_pass(command):
    make = lambda count: make_engine("single_track", count, command=command)  # noqa: E731
    assert check_simulator(make, "single_track") == []
