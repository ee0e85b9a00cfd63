"""The task over a car with brakes and reverse."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.core.config import build
from buggy_rl.simulators import make_engine
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env

COMMAND = "throttle_brake_reverse"


@pytest.mark.parametrize("name", ["rate_limit", "action_smoothing"])
def test_what_shapes_commands_begins_at_rest_in_the_middle(name):
    task = build(TaskConfig, [f"transforms.command.name={name}"])
    env = make_env(make_engine("single_track", 2, command=COMMAND), task=task)
    check_env_specs(env)
    state = env.reset()
    memory = {"rate_limit": keys.LIMITED_ACTION, "action_smoothing": keys.SMOOTHED_ACTION}[name]
    assert state[memory].abs().max() == 0.0
    assert state[keys.LAST_ACTION].abs().max() == 0.0
    state = env.step(state.set(keys.ACTION, torch.tensor([[-0.1, 0.0]] * 2)))["next"]
    # Towards reverse, from 0: no further than asked, and not from full reverse.
    assert (state[memory][:, 0] >= -0.1).all()
    assert (state[memory][:, 0] < 0.0).all()


def test_a_one_way_car_begins_at_the_lower_end_as_before():
    env = make_env(make_engine("single_track", 2))
    assert (env.reset()[keys.LAST_ACTION][:, 0] == -1.0).all()


def test_a_policy_s_command_can_reverse_the_car():
    env = make_env(make_engine("single_track", 2, command=COMMAND))
    state = env.reset()
    for _ in range(80):
        state = env.step(state.set(keys.ACTION, torch.tensor([[-0.8, 0.0]] * 2)))["next"]
        state = state.exclude(keys.REWARD)
    assert (state[keys.VELOCITY][:, 0] < -0.3).all()
