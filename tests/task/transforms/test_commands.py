import math

import pytest
import torch
from torchrl.envs import Transform

from buggy_rl.core import keys
from buggy_rl.core import keys as task
from buggy_rl.task.transforms.commands import ActionSmoothing, LastAction, RateLimit
from tests.task.transforms.cars import over_hold, start, step


class Told(Transform):
    """Keeps what reaches the engine; it stands nearest to it."""

    def _inv_call(self, tensordict):
        self.action = tensordict[keys.ACTION]
        return tensordict


def told(*transforms, actions):
    """What reaches the engine [T, 2] under actions, and the last state."""
    ear = Told()
    env = over_hold(ear, *transforms)
    state, rows = start(env), []
    for action in actions:
        acted = state.clone().set(keys.ACTION, torch.tensor(action))
        state = env.step(acted)["next"]
        assert acted[keys.ACTION].tolist() == pytest.approx(action)  # the data keep what was asked
        rows.append(ear.action)
    return torch.stack(rows), state


def test_smoothing_is_a_first_order_lag():
    share = 1 - math.exp(-0.01 / 0.05)
    rows, _ = told(ActionSmoothing(0.05, dt=0.01), actions=[[1.0, 1.0]] * 30)
    steps = torch.arange(1.0, 31.0)
    # from -1 and 0: 1 - (distance at first) * (1 - share)^n
    torch.testing.assert_close(rows[:, 0], 1 - 2 * (1 - share) ** steps)
    torch.testing.assert_close(rows[:, 1], 1 - (1 - share) ** steps)
    assert float(rows[4, 1]) == pytest.approx(1 - math.exp(-1), abs=1e-6)  # after 50 ms


def test_a_limited_command_changes_by_the_rate_and_no_more():
    limit = RateLimit(throttle=50.0, steering=10.0, dt=0.01)
    rows, _ = told(limit, actions=[[1.0, 0.25], [1.0, 0.25], [1.0, 0.25], [1.0, -1.0]])
    # throttle by 0.5 a step from -1, steering by 0.1 from 0 until it is where it should be
    expected = [[-0.5, 0.1], [0.0, 0.2], [0.5, 0.25], [1.0, 0.15]]
    torch.testing.assert_close(rows, torch.tensor(expected))


@pytest.mark.parametrize("make", [ActionSmoothing, RateLimit])
def test_a_command_beyond_its_range_counts_as_the_bound(make):
    near, _ = told(make(dt=0.01), actions=[[1.0, -1.0]] * 40)
    far, _ = told(make(dt=0.01), actions=[[9.0, -9.0]] * 40)
    assert torch.equal(near, far)


def test_the_last_action_is_what_went_to_the_car():
    _, state = told(LastAction(), actions=[[0.5, -0.5], [0.2, 3.0]])
    torch.testing.assert_close(state[task.LAST_ACTION], torch.tensor([0.2, 1.0]))
    # nearer to the engine than a limit, it sees what the limit gives out
    _, state = told(LastAction(), RateLimit(20.0, 10.0, dt=0.01), actions=[[-1.0, 1.0]])
    torch.testing.assert_close(state[task.LAST_ACTION], torch.tensor([-1.0, 0.1]))


def test_smoothing_and_limit_each_keep_their_own_memory():
    both = (RateLimit(20.0, 10.0, dt=0.01), ActionSmoothing(0.05, dt=0.01))
    rows, state = told(*both, actions=[[-1.0, 1.0]] * 3)
    # smoothed: 0.181, 0.330, 0.451; what reaches the car climbs by 0.1 a step
    torch.testing.assert_close(rows[:, 1], torch.tensor([0.1, 0.2, 0.3]))
    smoothed = 1 - math.exp(-0.03 / 0.05)
    assert float(state[task.SMOOTHED_ACTION][1]) == pytest.approx(smoothed, abs=1e-6)


def test_after_a_reset_the_car_was_told_to_stand_with_straight_wheels():
    for make in (ActionSmoothing, RateLimit):
        env = over_hold(make(dt=0.01), batch_size=(3,))
        state = step(env, start(env), action=(1.0, 1.0))
        mask = torch.tensor([[True], [False], [True]])
        after = env.reset(state.clone().set("_reset", mask), select_reset_only=True)
        memory = after[make.memory]
        assert memory[0].tolist() == memory[2].tolist() == [-1.0, 0.0]
        assert torch.equal(memory[1], state[make.memory][1])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ActionSmoothing(0.0, dt=0.01), "time_constant is 0.0"),
        (lambda: RateLimit(steering=-1.0, dt=0.01), "steering is -1.0 a second"),
    ],
)
def test_wrong_options_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()
