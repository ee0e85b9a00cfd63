"""A learned car that remembers nothing: its history has no rows."""

import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.simulators.learned.engine import LearnedEngine
from buggy_rl.simulators.learned.factory import ModelConfig, make_model


def test_some_cars_of_a_model_of_one_row_are_reset_and_the_others_stay():
    torch.manual_seed(0)
    model = make_model(ModelConfig(kind="mlp", options={"rows": 1}))
    cars = LearnedEngine(4, model=model)
    state = cars.reset()
    state[keys.POSE] = torch.arange(12.0).reshape(4, 3)
    before = state[keys.POSE].clone()
    asked = state.clone()
    asked["_reset"] = torch.tensor([[False], [True], [False], [False]])
    after = cars.reset(asked)
    assert after["history"].shape == (4, 0, 5)
    assert (after[keys.POSE][1] == 0).all()
    rest = [0, 2, 3]
    torch.testing.assert_close(after[keys.POSE][rest], before[rest])
    assert isinstance(after, TensorDict)
