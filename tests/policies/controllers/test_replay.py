import pytest
import torch
from tensordict import TensorDict

from buggy_rl.policies.controllers.replay import RandomDriver, ReplayDriver
from buggy_rl.simulators import make_engine


def state(*shape):
    return TensorDict({"velocity": torch.zeros(*shape, 3)}, shape)


def test_the_same_commands_from_the_same_start_drive_the_same_way():
    engine = make_engine("single_track", 3)
    first = engine.rollout(80, policy=RandomDriver(seed=1))
    again = engine.rollout(80, policy=ReplayDriver(first["action"]))
    assert torch.equal(again["next", "pose"], first["next", "pose"])


def test_one_row_a_step_for_all_cars_alike():
    actions = torch.arange(6.0).reshape(3, 2) / 10
    driver = ReplayDriver(actions)
    for row in range(3):
        driven = driver(state(4))["action"]
        assert torch.equal(driven, actions[row].expand(4, 2))


def test_there_is_nothing_after_the_last_row():
    driver = ReplayDriver(torch.zeros(1, 2))
    driver(state())
    with pytest.raises(IndexError, match="all 1 commands have been driven"):
        driver(state())


def test_what_is_no_row_of_commands_is_refused():
    with pytest.raises(ValueError, match=r"\(5, 3\): must be"):
        ReplayDriver(torch.zeros(5, 3))
