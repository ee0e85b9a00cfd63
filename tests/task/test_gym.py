import os
import warnings

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.data import Binary, Composite

from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.gym import NAME, WaypointsEnv
from buggy_rl.task.gym_interface import TOLD, ends
from buggy_rl.task.paths.making import PathConfig
from tests.plain_env import QuickCar

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
        warnings.simplefilter("error", UserWarning)  # Gymnasium's
        # the way to a waypoint has no bound to name
        warnings.filterwarnings("ignore", message=".*observation space m.*infinity.*")
        warnings.filterwarnings("ignore", message=".*of this source.*")  # no kernels
        check_env(env.unwrapped)
    env.close()


def test_nothing_that_gymnasium_checks_depends_on_gradients(env):
    with torch.enable_grad():
        env.reset(seed=0)
        env.step(np.zeros(2, np.float32))
    assert not any(value.requires_grad for value in env.unwrapped._state.values())


def test_stable_baselines3_learns_on_it():
    ppo = pytest.importorskip("stable_baselines3").PPO
    from stable_baselines3.common.env_checker import check_env as check_env_of_sb3

    env = gymnasium.make(NAME, engine="kinematic", task=FEW)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env_of_sb3(env.unwrapped)
    with torch.enable_grad():
        ppo("MlpPolicy", env, n_steps=64, batch_size=32, n_epochs=1, seed=0).learn(64)


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


@pytest.mark.parametrize("ended", [(), ("terminated",), ("done",), ("done", "terminated")])
def test_the_end_that_a_simulator_knows_of_ends_the_episode(ended):
    env = gymnasium.make(NAME, engine=EndingCar(ended), task=FEW)
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, np.float32))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (bool(ended), False)]


def test_the_truncation_that_a_simulator_knows_of_is_no_termination():
    # Without `path_end`, whose own truncation stands in its place.
    transforms = default_transforms() | {"path_end": TransformConfig()}
    engine = EndingCar(("done", "truncated"), declared=("done", "terminated", "truncated"))
    env = gymnasium.make(NAME, engine=engine, task=TaskConfig(FEW.paths, transforms))
    env.reset(seed=0)
    ends = [env.step(np.zeros(2, np.float32))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_a_step_that_says_done_and_no_more_is_a_termination():
    flags = TensorDict({"done": torch.tensor([[True], [False]])}, [2])
    terminated, truncated = ends(flags)
    assert terminated.tolist() == [[True], [False]]
    assert truncated.tolist() == [[False], [False]]
    terminated, truncated = ends(flags.set("truncated", flags["done"].clone()))
    assert terminated.tolist() == [[False], [False]]
    assert truncated.tolist() == [[True], [False]]


class EndingCar(QuickCar):
    """A user's simulator whose third step sets the flags `ended`, of those it declares."""

    def __init__(self, ended, declared=("done", "terminated")):
        super().__init__(())
        self.ended = ended
        self.full_done_spec = Composite({k: Binary(1, (1,), dtype=torch.bool) for k in declared})
        for spec in (self.observation_spec, self.state_spec):
            spec["steps"] = self._spec(1)

    def _step(self, tensordict):
        after = super()._step(tensordict)
        after["steps"] = tensordict["steps"] + 1
        for flag in self.ended:
            after[flag] = after["steps"] == 3
        return after


def test_an_unknown_option_or_keyword_is_refused_with_the_known_ones(env):
    with pytest.raises(
        ValueError, match=r"no option 'paht'; did you mean 'path'\? available: path"
    ):
        env.reset(options={"paht": 1})
    with pytest.raises(TypeError, match=r"keyword argument 'engin'; did you mean 'engine'\? avail"):
        gymnasium.make(NAME, engin="hold")
    env.reset(options={})


@pytest.mark.parametrize("path", [-1, 5, 1000])
def test_a_path_that_is_not_there_is_named(env, path):
    with pytest.raises(ValueError, match=rf"path is {path}: the task has 5 paths, from 0 to 4"):
        env.reset(options={"path": path})


@pytest.mark.parametrize("path", [1.0, True, "1", None, [1, 2]])
def test_a_path_that_is_no_integer_is_refused(env, path):
    with pytest.raises(ValueError, match=r"must be an integer$"):
        env.reset(options={"path": path})


def test_a_refused_option_leaves_the_random_numbers_alone(env):
    env.reset(seed=0)
    state = env.unwrapped.np_random.bit_generator.state
    with pytest.raises(ValueError, match="available"):
        env.reset(seed=1, options={"paht": 1})
    assert env.unwrapped.np_random.bit_generator.state == state


def paths_of_a_forked_process(env, count=12):
    """Paths that a copy of this process draws; twelve of five repeat once in 2e8."""
    out, into = os.pipe()
    if os.fork() == 0:
        os.write(into, bytes(env.reset()[1]["path"] for _ in range(count)))
        os._exit(0)
    os.wait()
    os.close(into)
    with open(out, "rb") as pipe:
        return list(pipe.read())


def test_forked_processes_do_not_repeat_each_other_unless_a_seed_was_given():
    env = gymnasium.make(NAME, engine="hold", task=FEW)
    env.reset()
    assert paths_of_a_forked_process(env) != paths_of_a_forked_process(env)
    env.reset(seed=3)
    drawn = paths_of_a_forked_process(env)
    assert drawn == paths_of_a_forked_process(env)
    assert drawn == [env.reset()[1]["path"] for _ in drawn]


def test_unseeded_environments_and_resets_differ():
    envs = [gymnasium.make(NAME, engine="hold", task=FEW) for _ in range(2)]
    drawn = [[env.reset()[1]["path"] for _ in range(12)] for env in envs]
    assert drawn[0] != drawn[1]
    assert len(set(drawn[0])) > 1


def test_a_generator_of_the_users_own_is_drawn_from(env):
    drawn = []
    for _ in range(2):
        env.unwrapped.np_random = np.random.default_rng(7)
        drawn.append([env.reset()[1]["path"] for _ in range(12)])
    assert drawn[0] == drawn[1]


def test_keys_and_kinds_of_infos_stay_the_same(env):
    _, first = env.reset(seed=0)
    assert first.keys() == {*TOLD, "pose", "velocity"}
    for _ in range(5):
        observation, reward, _, _, info = env.step(np.array([0.5, 1.0], np.float32))
        assert observation.dtype == np.float32
        assert observation.shape == env.observation_space.shape
        assert type(reward) is float
        assert {k: type(v) for k, v in info.items()} == {k: type(v) for k, v in first.items()}


def space(**changed):
    transforms = default_transforms() | changed
    env = gymnasium.make(NAME, engine="single_track", task=TaskConfig(FEW.paths, transforms))
    return env.observation_space


CLIP = TransformConfig("clip_velocity", {"low": [-0.1, -0.2, -0.3], "high": [0.4, 0.5, 0.6]})


def test_velocities_have_the_bounds_of_the_clip_and_waypoints_none():
    box = space(clip=CLIP)
    np.testing.assert_allclose(box.low[:3], [-0.1, -0.2, -0.3])
    np.testing.assert_allclose(box.high[:3], [0.4, 0.5, 0.6])
    assert np.isinf(box.low[3:]).all()
    assert np.isinf(box.high[3:]).all()
    shown = ["last_action", "velocity", "waypoints"]
    inputs = TransformConfig("observation", {"inputs": shown})
    rows = space(observation=inputs, history=TransformConfig("history", {"rows": 2}))
    assert rows.shape == (50,)
    assert np.isfinite(rows.low).nonzero()[0].tolist() == [2, 3, 4, 27, 28, 29]


@pytest.mark.parametrize(
    "late",
    [
        {"clip": TransformConfig()},
        {"late": TransformConfig("observation_noise", before="waypoints")},
        {"late": TransformConfig("past_mean", before="waypoints")},
        {"late": TransformConfig("torchrl.envs:ObservationNorm", {
            "loc": 0.0, "scale": 2.0, "in_keys": ["observation"]})},
    ],
    ids=["no clip", "noise", "mean", "foreign"],
)  # fmt: skip
def test_a_velocity_that_something_changes_behind_the_clip_has_no_bound(late):
    assert np.isinf(space(**late).low).all()


@given(st.floats(-1, 1), st.floats(-1, 1), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=6)
def test_no_drive_leaves_the_space_on_the_path_or_far_from_it(throttle, steering, seed):
    env = BOUNDED
    observation, _ = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(100):  # the episode ends after some of them, the car drives on
        action = np.clip([throttle, steering] + 0.5 * rng.normal(size=2), -1, 1)
        assert observation in env.observation_space
        observation, *_ = env.step(action.astype(np.float32))


NEAR = TransformConfig("leave_path", {"limit": 0.1})
BOUNDED = WaypointsEnv(
    "kinematic",
    task=TaskConfig(FEW.paths, default_transforms() | {"clip": CLIP, "leave_path": NEAR}),
)


def test_a_drive_reaches_the_bounds_and_leaves_the_path():
    BOUNDED.reset(seed=0)
    steps = [BOUNDED.step(np.array([1.0, 0.5], np.float32)) for _ in range(100)]
    reached = [observation for observation, *_ in steps]
    assert 0 < sum(terminated for _, _, terminated, _, _ in steps) < 100
    np.testing.assert_array_equal(np.max(reached, 0)[:3:2], BOUNDED.observation_space.high[:3:2])


def test_a_batch_of_cars_is_refused():
    batch = make_env("hold", task=FEW, batch_size=4).base_env
    with pytest.raises(ValueError, match=r"batch of \(4,\)"):
        gymnasium.make(NAME, engine=batch, task=FEW)


def test_a_step_before_a_reset_is_refused():
    env = gymnasium.make(NAME, engine="hold", task=FEW)
    with pytest.raises(RuntimeError, match="reset"):
        env.unwrapped.step(np.zeros(2, np.float32))
