"""What every transform of the task must prove, whatever moves the car beneath it."""

from functools import partial

import pytest
import torch
from torchrl.envs import Compose, SerialEnv
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.task.config import TaskConfig, TransformConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import joined_paths
from buggy_rl.task.stack import StackedEnv
from buggy_rl.task.transforms import TRANSFORMS, make_transform
from tests.contracts.test_engines import make

BEFORE = {  # what must stand before a transform for it to have something to work on
    "leave_path": ["waypoints"],
    "path_end": ["waypoints"],
    "rewards": ["waypoints"],
    "observation": ["waypoints"],
    "history": ["waypoints", "observation"],
}
OPTIONS = {"step_limit": {"max_steps": 6}, "leave_path": {"limit": 0.05}}
EVERYTHING = {  # all of them at once
    place: TransformConfig(name, OPTIONS.get(name, {}))
    for place, name in {
        "last_action": "last_action",
        "command": "rate_limit",
        "smoothing": "action_smoothing",
        "noise": "observation_noise",
        "filter": "past_mean",
        "clip": "clip_velocity",
        "waypoints": "waypoints",
        "target_speed": "target_speed",
        "observation": "observation",
        "history": "history",
        "leave_path": "leave_path",
        "path_end": "path_end",
        "rewards": "rewards",
        "step_limit": "step_limit",
    }.items()
}
STACKS = [*TRANSFORMS, "everything"]


def paths():
    """Open and closed ones, of different lengths, begun in different places."""
    config = PathConfig(count=3, waypoints=30, placed=True)
    return joined_paths([make_paths(config), make_paths(PathConfig(kind="lap", placed=True))])


def stacked(name, engine="learned", batch_size=()):
    if name == "everything":
        task = TaskConfig(transforms=EVERYTHING)
        return make_env(make(engine, batch_size), task=task, paths=paths())
    env = StackedEnv(make(engine, batch_size), Compose([]))
    for part in [*BEFORE.get(name, []), name]:
        env.append_transform(make_transform(part, OPTIONS.get(part), paths=paths(), dt=0.01))
    return env


def driven(env, steps=4, seed=0):
    """A state in the middle of a drive, with an action to take from it."""
    generator = torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)
    state = env.reset()
    for _ in range(steps + 1):
        action = torch.rand(*env.batch_size, 2, generator=generator) * 2 - 1
        state = state.set(keys.ACTION, action)
        if _ < steps:
            state = env.step(state)["next"]
    return state


@pytest.fixture(params=STACKS)
def name(request):
    return request.param


@pytest.fixture(params=["learned", "mujoco"])
def engine(request):
    return request.param


@pytest.mark.parametrize("batch_size", [(), (4,), (2, 3)], ids=["one", "four", "two by three"])
def test_it_keeps_its_specs(name, engine, batch_size):
    env = stacked(name, engine, batch_size)
    check_env_specs(env)
    assert env.batch_size == batch_size


def test_it_works_inside_a_batch_of_environments(name):
    several = SerialEnv(2, partial(stacked, name, batch_size=(3,)))
    check_env_specs(several)
    several.close()


def test_the_same_seed_gives_the_same_drive(name, engine):
    first, second, other = (driven(stacked(name, engine, (4,)), seed=s) for s in (3, 3, 4))
    assert set(first.keys()) == set(second.keys())
    for key in sorted(first.keys()):
        assert torch.equal(first[key], second[key]), key
    assert not torch.equal(first[keys.POSE], other[keys.POSE])


def test_two_steps_from_one_tensordict_are_equal_and_leave_it_as_it_was(name, engine):
    env = stacked(name, engine, (4,))
    state = driven(env)
    before = state.clone()
    first = env.step(state.copy())["next"].clone()
    assert (state == before).all()
    driven(env, seed=1)  # whatever happens in between
    second = env.step(state.copy())["next"]
    for key in sorted(first.keys()):
        assert torch.equal(first[key], second[key]), key


def test_a_reset_of_some_cars_leaves_the_others_as_they_are(name, engine):
    env = stacked(name, engine, (4,))
    state = env.step(driven(env))["next"].exclude(keys.REWARD)
    mask = torch.tensor([True, False, False, True])
    after = env.reset(state.clone().set("_reset", mask[:, None]), select_reset_only=True)
    drawn = after.select(keys.PATH, keys.NOISE_STATE, keys.TARGET_SPEED, strict=False)
    fresh = env.reset(drawn, set_state=True)
    for key in sorted(fresh.keys()):
        assert torch.equal(after[key][~mask], state[key][~mask]), key
        assert torch.equal(after[key][mask], fresh[key][mask]), key


def test_what_it_writes_is_finite(name, engine):
    state = stacked(name, engine, (4,)).step(driven(stacked(name, engine, (4,))))["next"]
    for key, value in state.items():
        assert value.isfinite().all(), key


def test_cars_of_a_batch_do_not_feel_one_another(name):
    env = stacked(name, batch_size=(4,))
    state = driven(env)
    together = env.step(state.clone())["next"]
    lone = stacked(name)
    lone.reset()
    for car in range(4):
        alone = lone.step(state[car].clone())["next"]
        for key in sorted(alone.keys()):
            torch.testing.assert_close(
                alone[key], together[key][car], atol=1e-5, rtol=1e-5, msg=f"{key} of car {car}"
            )
