import torch
from tensordict import TensorDict

from buggy_rl.policies.controllers.replay import RandomDriver
from buggy_rl.simulators import make_engine


def commands(seed=0, hold=0.05, cars=64, steps=40):
    driver, state = RandomDriver(hold, seed), TensorDict({"velocity": torch.zeros(cars, 3)}, [cars])
    return torch.stack([driver(state.clone())["action"] for _ in range(steps)], 1)


def test_commands_are_spread_evenly_over_their_range():
    rows = commands(cars=2000, steps=5)[:, 0]
    assert rows.abs().max() <= 1
    assert rows.mean(0).abs().max() < 0.05
    assert (rows.var(0) - 1 / 3).abs().max() < 0.03


def test_each_command_is_held():
    rows = commands().reshape(64, 8, 5, 2)  # 0.05 s are 5 steps
    assert (rows == rows[:, :, :1]).all()
    assert (rows[:, 1:, 0] != rows[:, :-1, 0]).all()


def test_one_seed_is_one_drive_and_the_global_state_is_left_alone():
    before = torch.get_rng_state()
    one, same, other = (commands(seed) for seed in (3, 3, 4))
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_it_is_a_policy_for_a_rollout():
    rows = make_engine("kinematic", 2).rollout(100, policy=RandomDriver())
    assert rows["next", "velocity"][..., 0].max() > 0.1
