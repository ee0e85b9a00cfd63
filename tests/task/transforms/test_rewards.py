import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.core import keys as task
from buggy_rl.task.transforms.commands import LastAction
from buggy_rl.task.transforms.rewards import TERMS, LeavePath, Rewards
from buggy_rl.task.transforms.waypoints import TargetSpeed, Waypoints
from tests.contracts.test_transforms import stacked
from tests.task.transforms.cars import over_hold, start, step, straight_path

ONES = dict.fromkeys(TERMS, 1.0)


def rewarded(weights, batch_size=()):
    stack = (LastAction(), Waypoints(straight_path()), TargetSpeed(2.0, 2.0), LeavePath())
    return over_hold(*stack, Rewards(weights), batch_size=batch_size)


def terms(before, action, **edits):
    """Each term by name, with weight 1."""
    env = rewarded(ONES)
    state = start(env)
    state = step(env, state, **before)
    after = step(env, state, action=action, **edits)
    assert float(after[keys.REWARD]) == pytest.approx(float(after[task.REWARD_TERMS].sum()))
    return dict(zip(ONES, after[task.REWARD_TERMS].tolist(), strict=True))


def test_each_term_is_what_its_name_says():
    got = terms(
        before={"pose": (0.4, 0.0, 0.0), "action": (0.0, 0.25)},
        action=(0.0, -0.5),
        pose=(2.3, -0.2, 0.0),
    )
    assert got["waypoints_closed"] == 2.0  # x = 1 and x = 2
    assert got["progress"] == pytest.approx(1.9, abs=1e-6)
    assert got["deviation"] == pytest.approx(-0.2, abs=1e-6)
    assert got["steering_effort"] == pytest.approx(-(0.75**2))
    assert got["speed_error"] == -2.0  # stands, and 2 m/s were asked for
    assert got["terminated"] == 0.0


def test_failing_and_driving_back_cost():
    got = terms(before={"pose": (0.9, 0.0, 0.0)}, action=(0.0, 0.0), pose=(0.5, 1.5, 0.0))
    assert got["terminated"] == -1.0
    assert got["progress"] == pytest.approx(-0.4, abs=1e-6)
    assert got["deviation"] == -1.5


def test_the_reward_is_the_weighted_sum():
    env = rewarded({"waypoints_closed": 2.0, "deviation": 0.1})
    after = step(env, start(env), pose=(1.1, 0.3, 0.0))
    torch.testing.assert_close(after[task.REWARD_TERMS], torch.tensor([2.0, -0.03]))
    torch.testing.assert_close(after[keys.REWARD], torch.tensor([1.97]))


def test_the_default_is_the_originals_one_for_each_waypoint():
    env = over_hold(Waypoints(straight_path()), Rewards())
    state = start(env, velocity=(50.0, 0.0, 0.0))
    rewards = []
    for _ in range(6):
        state = step(env, state)
        rewards.append(float(state[keys.REWARD]))
    assert rewards == [0, 0, 1, 0, 1, 0]


def test_the_target_speed_is_drawn_at_a_reset_and_kept():
    torch.manual_seed(0)
    env = over_hold(TargetSpeed(1.0, 3.0), batch_size=(2000,))
    state = start(env)
    drawn = state[task.TARGET_SPEED]
    assert (drawn >= 1.0).all()
    assert (drawn <= 3.0).all()
    assert float(drawn.mean()) == pytest.approx(2.0, abs=0.06)  # five standard errors
    assert torch.equal(step(env, state)[task.TARGET_SPEED], drawn)
    assert not torch.equal(start(env)[task.TARGET_SPEED], drawn)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Rewards({"joy": 1.0}), "no term joy; available: command_excess, deviation"),
        (lambda: Rewards({}), "no term at all"),
        (lambda: TargetSpeed(3.0, 1.0), "low 3.0 and high 1.0"),
    ],
)
def test_wrong_options_are_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_leaving_what_a_learned_simulator_knows_costs_and_other_engines_know_no_such_range():
    from tensordict import TensorDict

    from buggy_rl.task.transforms.rewards import out_of_range

    reward = torch.zeros(3, 1)
    flag = torch.tensor([[True], [False], [True]])
    learned = TensorDict({keys.REWARD: reward, keys.OUT_OF_RANGE: flag}, [3])
    assert out_of_range(learned, learned).flatten().tolist() == [-1.0, 0.0, -1.0]
    other = TensorDict({keys.REWARD: reward}, [3])
    assert out_of_range(other, other).flatten().tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("velocity", [0.0, 1.0])
def test_what_the_task_writes_has_a_gradient_on_the_path_too(velocity):
    env = stacked("everything", "kinematic", (2,))
    env.set_seed(0)
    state = env.reset()
    state[keys.VELOCITY] = torch.full((2, 3), velocity) * torch.eye(3)[0]
    action = torch.zeros(2, 2, requires_grad=True)
    with torch.enable_grad():
        for _ in range(3):
            state = env.step(state.set(keys.ACTION, action))["next"]
        assert state[keys.LATERAL_ERROR].requires_grad
        for key, value in state.items(True, True):
            if value.requires_grad:
                (gradient,) = torch.autograd.grad(
                    value.sum(), action, retain_graph=True, allow_unused=True
                )
                assert gradient is None or gradient.isfinite().all(), key
