"""What TorchRL's `_reset`, `_step` and `set_state` do to every engine, adapter and task."""

import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import RewardSum

from buggy_rl.core import keys
from buggy_rl.effects import make_effect
from buggy_rl.simulators import ENGINES, from_step, make_engine
from buggy_rl.task.env import make_env, with_effects
from tests import plain_env
from tests.contracts.test_engines import make
from tests.contracts.test_transforms import paths, stacked

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
MASK = torch.tensor([True, False, False, True])


def lagging(pose, velocity):
    return {"push": 0.0}


def pushed(state, action):
    """A car that remembers its push."""
    push = 0.5 * state["push"] + action[0]
    velocity = np.array([state["velocity"][0] + 0.01 * push, 0.0, action[1]])
    return {"pose": state["pose"] + 0.01 * velocity, "velocity": velocity, "push": push}


def with_memories(count):
    """An engine under effects that remember, on the command, the motion and the sensor."""
    names = ("throttle_lag", "steering_dead_time", "sensor_latency", "sensor_lag", "heading_drift")
    size = {"steering_dead_time": {"dead_time": 0.04}, "sensor_latency": {"dead_time": 0.03}}
    size["heading_drift"] = {"rate": 0.1}
    return with_effects(
        make("single_track", count),
        [make_effect(name, size.get(name, {"time_constant": 0.05})) for name in names],
    )


def differing(count):
    """Engine and effect with other values in each environment: no reset of some alone."""
    car = make("single_track", count)
    mass = torch.linspace(1.0, 2.0, car.numel()).reshape(car.batch_size)
    car = car.with_parameters(TensorDict({"mass": mass}, car.batch_size))
    lag = make_effect("throttle_lag").with_parameters(
        TensorDict({"time_constant": 0.05 * mass}, car.batch_size)
    )
    return with_effects(car, [lag])


SIMULATORS = {
    **{name: partial(make, name) for name in sorted(ENGINES)},
    "functions": lambda count: make_engine(from_step(lagging, pushed), count),
    "plain, in double precision": lambda count: make_engine(plain_env.make_quick, count),
    "one at a time": lambda count: make_engine(lambda _, __: plain_env.make_quick(1), count),
    "mjcf": lambda count: make_engine(f"{EXAMPLES}/mjcf_car.py:make", count),
    "gymnasium": lambda count: make_engine(f"{EXAMPLES}/gym_car.py:make", count),
    "effects": with_memories,
    "differing": differing,
    "task": lambda count: make_env(make("learned", count), paths=paths()),
    "everything": partial(stacked, "everything", "mujoco"),
}


@pytest.fixture(params=SIMULATORS)
def build(request):
    return SIMULATORS[request.param]


def acting(env, state, seed=0):
    generator = torch.Generator().manual_seed(seed)
    action = torch.rand(*env.batch_size, 2, generator=generator) * 2 - 1
    return state.set(keys.ACTION, action)


def driven(env, steps=4):
    """A state in the middle of a drive."""
    env.set_seed(0)
    state = env.reset()
    for step in range(steps):
        state = env.step_mdp(env.step(acting(env, state, step)))
    return state.exclude(keys.ACTION)


def same(first, second, names=None):
    for key in names or first.keys(True, True):
        assert torch.equal(first[key], second[key]), key


def fresh_like(env, state):
    """A reset of all that draws the same path, noise and speed."""
    drawn = state.select(keys.PATH, keys.NOISE_STATE, keys.TARGET_SPEED, strict=False)
    return env.reset(drawn, set_state=True)


@pytest.mark.parametrize("flag", [None, False])
def test_masked_environments_begin_anew_and_others_stay_to_the_last_bit(build, flag):
    env = build(4)
    state = driven(env)
    after = env.reset(state.clone().set("_reset", MASK[:, None]), set_state=flag)
    fresh = fresh_like(env, after)
    assert not {"_reset", "_environment"} & set(after.keys())
    for key in fresh.keys(True, True):
        torch.testing.assert_close(after[key][MASK], fresh[key][MASK], atol=1e-6, rtol=1e-5)
        assert torch.equal(after[key][~MASK], state[key][~MASK]), key


def test_a_mask_reaches_the_rows_of_a_batch_of_two_dimensions():
    for env in (make("mujoco", (2, 3)), stacked("everything", "learned", (2, 3))):
        state = driven(env)
        mask = torch.tensor([[False, True, False], [False, False, True]])
        after = env.reset(state.clone().set("_reset", mask))
        fresh = fresh_like(env, after)
        for key in fresh.keys(True, True):
            torch.testing.assert_close(after[key][mask], fresh[key][mask], atol=1e-6, rtol=1e-5)
            assert torch.equal(after[key][~mask], state[key][~mask]), key


def test_a_state_that_is_set_goes_on_as_it_would_have(build):
    env = build(4)
    state = driven(env)
    again = env.reset(state.clone(), set_state=True)
    for step in range(5, 8):
        state, again = (env.step(acting(env, s, step))["next"] for s in (state, again))
        names = [key for key in state.keys(True, True) if key != keys.REWARD or step > 5]
        same(state, again, names)


def test_masked_environments_are_set_and_others_stay(build):
    env = build(4)
    state, other = driven(env), driven(env, 7)
    mixed = TensorDict({k: v.clone() for k, v in state.items()}, state.batch_size)
    mixed[MASK] = other[MASK]
    after = env.reset(mixed.clone().set("_reset", MASK[:, None]), set_state=True)
    same(after, mixed, list(env.state_spec.keys(True, True)))


def test_a_state_that_is_not_to_be_set_is_ignored(build):
    env = build(4)
    state = env.reset(driven(env), set_state=False)
    fresh = fresh_like(env, state)
    same(fresh, state, list(fresh.keys(True, True)))


@pytest.mark.parametrize("name", ["single_track", "task"])
def test_a_state_without_a_word_is_honoured_with_torchrls_warning(name):
    env = SIMULATORS[name](4)
    start = TensorDict({keys.VELOCITY: torch.ones(4, 3)}, [4])
    with pytest.warns(FutureWarning, match="without specifying `set_state`"):
        state = env.reset(start)
    assert torch.equal(state[keys.VELOCITY], torch.ones(4, 3))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env.reset()
        env.reset(start, set_state=True)
        env.reset(env.reset().set("_reset", MASK[:, None]))


def test_an_environment_that_does_not_move_stays_as_it_is(build):
    env = build(4)
    state = acting(env, driven(env))
    moved = env.step(state.clone())["next"]
    after = env.step(state.clone().set("_step", MASK))["next"]
    for key in moved.keys(True, True):
        assert torch.equal(after[key][MASK], moved[key][MASK]), key
        if key != keys.REWARD:
            assert torch.equal(after[key][~MASK], state[key][~MASK]), key
    assert not after[keys.REWARD][~MASK].any()
    none = env.step(state.clone().set("_step", torch.zeros(4, dtype=torch.bool)))["next"]
    assert torch.equal(none[keys.POSE], state[keys.POSE])


def test_a_rollout_until_all_are_done_keeps_those_that_ended_where_they_are():
    env = make_env(make("hold", 3), paths=paths())
    state = env.reset()
    state[keys.VELOCITY] = torch.tensor([[200.0, 0, 0], [50.0, 0, 0], [100.0, 0, 0]])
    rows = env.rollout(50, break_when_any_done=False, break_when_all_done=True,
                       auto_reset=False, tensordict=state)  # fmt: skip
    done = rows["next", "done"].squeeze(-1)
    assert done[:, -1].all()
    for car in range(3):
        last = int(done[car].int().argmax())
        assert (rows["next", keys.POSE][car, last:] == rows["next", keys.POSE][car, last]).all()


def test_a_collector_begins_anew_where_an_episode_ends():
    env = stacked("everything", "learned", (4,))
    env.append_transform(RewardSum())
    env.set_seed(0)
    collector = Collector(env, frames_per_batch=80, total_frames=80)
    (batch,) = list(collector)
    done, follows = batch["next", "done"][:, :-1, 0], batch[:, 1:]
    assert 4 < done.sum() < 40
    assert not follows[keys.VELOCITY][done].any()
    assert (follows[keys.NEXT_WAYPOINT][done] == 1).all()
    assert not follows[keys.STEP_COUNT][done].any()
    for key in set(follows["next"].keys()) & set(follows.keys()) - {keys.REWARD}:
        going = batch["next", key][:, :-1][~done]
        assert torch.equal(follows[key][~done], going), key
    # the reward of an episode begins anew as well
    sums, reward = batch["next", "episode_reward"][..., 0], batch["next", keys.REWARD][..., 0]
    expected = torch.zeros(4)
    for k in range(20):
        expected = expected + reward[:, k]
        torch.testing.assert_close(sums[:, k], expected)
        expected = expected * ~batch["next", "done"][:, k, 0]


def test_only_the_masked_environments_are_computed(monkeypatch):
    env = make_env(make("single_track", 64), paths=paths())
    asked = []
    rest = type(env.base_env)._rest_latent
    monkeypatch.setattr(
        type(env.base_env),
        "_rest_latent",
        lambda self, pose, velocity: asked.append(len(pose)) or rest(self, pose, velocity),
    )
    mask = torch.zeros(64, 1, dtype=torch.bool)
    mask[[3, 50]] = True
    env.reset(env.reset().set("_reset", mask), select_reset_only=True)
    assert asked == [64, 2]


@pytest.mark.parametrize("name", [*sorted(ENGINES)])
def test_an_empty_batch_is_refused_by_name(name):
    with pytest.raises(ValueError, match="batch_size is 0: at least one"):
        make(name, 0)


def test_an_empty_batch_of_ones_own_simulator_is_refused_by_name():
    with pytest.raises(ValueError, match="batch_size is 0: at least one"):
        make_env(plain_env.make, batch_size=0)
