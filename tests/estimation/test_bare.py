"""Motion effects on separate rows are stepped in one pass, in the order of those that share one."""

import torch
from tensordict import TensorDict

from buggy_rl.effects import make_effect
from buggy_rl.estimation.bare import BareEnv, _separate
from buggy_rl.simulators import make_engine

ROWS = 6


def acting(name, parameter, value, rows):
    values = torch.zeros(ROWS)
    values[rows] = value
    return make_effect(name).with_parameters(TensorDict({parameter: values}, [ROWS]))


def effects():
    return [
        acting("rolling_resistance", "deceleration", 0.3, [0, 1]),
        acting("viscous_drag", "rate", 0.4, [2, 3]),
        acting("torque_steer", "offset", 0.05, [1, 4]),
        acting("aerodynamic_drag", "coefficient", 0.1, [1]),
    ]


def test_an_effect_follows_those_before_it_in_the_same_row():
    first, second, third, fourth = effects()
    assert _separate([first, second, third, fourth]) == [[first, second], [third], [fourth]]


def test_of_a_stack_three_passes_are_left():
    assert len(BareEnv(make_engine("single_track", ROWS), effects())._steps) == 3
