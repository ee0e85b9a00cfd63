"""A counting environment: the state says how many steps were taken, and with which actions."""

from itertools import pairwise

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded
from torchrl.envs import EnvBase

from buggy_rl.core.stepping import trajectory

STEPS = 5


class Counting(EnvBase):
    """count' = count + 1, total' = total + action; batch of two."""

    def __init__(self):
        super().__init__(batch_size=torch.Size([2]))
        one = Unbounded(torch.Size([2, 1]))
        self.observation_spec = Composite(count=one, total=one, shape=torch.Size([2]))
        self.state_spec = Composite(count=one.clone(), total=one.clone(), shape=torch.Size([2]))
        self.action_spec = Unbounded(torch.Size([2, 1]))
        self.reward_spec = Unbounded(torch.Size([2, 1]))

    def _reset(self, tensordict=None, **kwargs):
        return TensorDict(
            count=torch.zeros(2, 1), total=torch.zeros(2, 1), batch_size=torch.Size([2])
        )

    def _step(self, tensordict):
        done = torch.zeros(2, 1, dtype=torch.bool)
        return TensorDict(
            count=tensordict["count"] + 1,
            total=tensordict["total"] + tensordict["action"],
            reward=torch.zeros(2, 1),
            done=done,
            terminated=done.clone(),
            batch_size=[2],
        )

    def _set_seed(self, seed):
        return seed


@pytest.fixture
def env():
    return Counting()


def ten_times_the_step(row, state):
    return state.set("action", torch.tensor([[10.0 * row], [-10.0 * row]]))


def test_every_state_is_yielded_the_first_and_the_last_included(env):
    states = list(trajectory(env, env.reset(), ten_times_the_step, STEPS))
    assert [state["count"][0].item() for state in states] == [0, 1, 2, 3, 4, 5]
    # 0 + 10 + 20 + 30 + 40, and the sum before each of them.
    assert [state["total"][0].item() for state in states] == [0, 0, 10, 30, 60, 100]
    assert [state["total"][1].item() for state in states] == [0, 0, -10, -30, -60, -100]


def test_pairs_hold_a_state_with_its_action_and_the_next_state(env):
    pairs = list(pairwise(trajectory(env, env.reset(), ten_times_the_step, STEPS)))
    assert len(pairs) == STEPS
    for row, (before, after) in enumerate(pairs):
        assert before["action"][0] == 10 * row
        assert before["count"][0] == row
        assert after["count"][0] == row + 1


def test_a_step_starts_from_the_state_that_act_returns(env):
    def imposed(row, state):
        return state.set("count", torch.full((2, 1), 100.0 * row)).set("action", torch.ones(2, 1))

    counts = [state["count"][0].item() for state in trajectory(env, env.reset(), imposed, 3)]
    assert counts[1:-1] != [1, 2]
    assert counts[-1] == 201


def test_act_may_look_at_the_state_it_acts_on(env):
    seen = []

    def act(row, state):
        seen.append((row, state["count"][0].item()))
        return state.set("action", torch.zeros(2, 1))

    list(trajectory(env, env.reset(), act, 3))
    assert seen == [(0, 0), (1, 1), (2, 2)]


def test_no_step_is_taken_before_its_state_is_asked_for(env):
    acted = []

    def act(row, state):
        acted.append(row)
        return state.set("action", torch.zeros(2, 1))

    states = trajectory(env, env.reset(), act, STEPS)
    next(states)
    assert acted == []
    next(states)
    assert acted == [0]


def test_without_steps_only_the_start_is_yielded(env):
    states = list(trajectory(env, env.reset(), ten_times_the_step, 0))
    assert [state["count"][0].item() for state in states] == [0]


def test_no_graph_is_kept_and_the_callers_gradient_mode_stays(env):
    weight = torch.ones(2, 1, requires_grad=True)
    for state in trajectory(env, env.reset(), lambda _, s: s.set("action", weight * 1.0), 2):
        assert torch.is_grad_enabled()
        assert not state["total"].requires_grad
