import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env

from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.gym import NAME
from buggy_rl.task.paths.making import PathConfig

FEW = TaskConfig(paths=PathConfig(count=5, waypoints=60))


@pytest.fixture
def env():
    env = gymnasium.make(NAME, engine="single_track", task=FEW)
    yield env
    env.close()


@pytest.mark.parametrize("engine", ["single_track", "mujoco"])
def test_gymnasiums_own_check_passes(engine):
    env = gymnasium.make(NAME, engine=engine, task=FEW)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # velocities and places have no bound to name
        warnings.filterwarnings("ignore", message=".*infinity.*")
        check_env(env.unwrapped)
    env.close()


def test_it_is_the_same_environment(env):
    under = make_env("single_track", task=FEW)
    observation, info = env.reset(options={"path": 3})
    state = under.reset(
        under.full_state_spec.zero().select("path").set("path", torch.tensor([3])), set_state=True
    )
    rng = np.random.default_rng(0)
    for _ in range(50):
        np.testing.assert_array_equal(observation, state["observation"].numpy())
        assert info["path"] == 3
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        state = under.step(state.set("action", torch.from_numpy(action)))["next"]
        assert reward == float(state["reward"])
        assert (terminated, truncated) == (bool(state["terminated"]), bool(state["truncated"]))
        assert info["lateral_error"] == float(state["lateral_error"])


def test_a_seed_fixes_paths_and_leaves_the_rest_of_pytorch_alone(env):
    def chosen(seed):
        first = env.reset(seed=seed)[1]["path"]
        return [first] + [env.reset()[1]["path"] for _ in range(20)]

    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    drawn = chosen(1)
    assert torch.equal(torch.random.get_rng_state(), before)
    assert drawn == chosen(1)
    assert drawn != chosen(2)
    assert set(drawn) == set(range(5))


def test_a_seed_fixes_the_noise_too():
    transforms = default_transforms()
    transforms["noise"] = TransformConfig("observation_noise")
    shown = []
    for seed in (3, 3, 4):
        env = gymnasium.make(NAME, engine="kinematic", task=TaskConfig(FEW.paths, transforms))
        first, _ = env.reset(seed=seed)
        second, _ = env.reset()
        shown.append(np.stack([first, second]))
        env.close()
    np.testing.assert_array_equal(shown[0], shown[1])
    assert (shown[0] != shown[2]).any()


def test_what_was_shown_is_not_overwritten_by_the_next_step(env):
    first, info = env.reset(seed=0)
    kept, pose = first.copy(), info["pose"].copy()
    for _ in range(30):
        env.step(np.array([1.0, 0.3], np.float32))
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(info["pose"], pose)


def test_standing_still_is_truncated_and_driving_off_is_terminated():
    transforms = default_transforms()
    transforms["step_limit"] = TransformConfig("step_limit", {"max_steps": 150})
    transforms["leave_path"] = TransformConfig("leave_path", {"limit": 0.3})
    env = gymnasium.make(NAME, engine="single_track", task=TaskConfig(FEW.paths, transforms))
    env.reset(seed=0)
    ends = [env.step(np.array([-1.0, 0.0], np.float32))[2:4] for _ in range(150)]
    assert ends[:-1] == [(False, False)] * 149
    assert ends[-1] == (False, True)
    env.reset(seed=0)
    for _ in range(149):
        _, _, terminated, truncated, info = env.step(np.array([0.5, 1.0], np.float32))
        if terminated or truncated:
            break
    assert (terminated, truncated) == (True, False)
    assert abs(info["lateral_error"]) > 0.3


def test_a_task_without_an_end_is_never_truncated():
    transforms = default_transforms()
    transforms["step_limit"] = transforms["path_end"] = TransformConfig()
    env = gymnasium.make(NAME, engine="hold", task=TaskConfig(FEW.paths, transforms))
    env.reset()
    assert env.step(np.zeros(2, np.float32))[2:4] == (False, False)


def test_a_batch_of_cars_is_refused():
    batch = make_env("hold", task=FEW, batch_size=4).base_env
    with pytest.raises(ValueError, match=r"batch of \(4,\)"):
        gymnasium.make(NAME, engine=batch, task=FEW)


def test_a_step_before_a_reset_is_refused():
    env = gymnasium.make(NAME, engine="hold", task=FEW)
    with pytest.raises(RuntimeError, match="reset"):
        env.unwrapped.step(np.zeros(2, np.float32))
