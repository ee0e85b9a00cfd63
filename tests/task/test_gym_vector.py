"""Many cars in one batch are what Gymnasium's own loop over single cars is."""

import warnings
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv

from buggy_rl.simulators import make_engine
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.gym import NAME, WaypointsEnv
from buggy_rl.task.gym_vector import WaypointsVectorEnv
from buggy_rl.task.paths.making import PathConfig

CARS, STEPS = 6, 50  # of an episode
SHORT = default_transforms() | {
    "leave_path": TransformConfig("leave_path", {"limit": 0.1}),
    "step_limit": TransformConfig("step_limit", {"max_steps": STEPS}),
}
SEVERAL = TaskConfig(PathConfig(count=5, waypoints=60), SHORT)
ONE = TaskConfig(PathConfig(count=1, waypoints=60), SHORT)


@pytest.fixture
def envs():
    envs = gymnasium.make_vec(NAME, num_envs=CARS, engine="kinematic", task=SEVERAL)
    yield envs
    envs.close()


def commands(steps):
    """Actions [steps, N, 2]; the first car stands still, the others turn off their path."""
    drawn = np.random.default_rng(0).uniform(-1, 1, (CARS, 2))
    drawn[:, 0], drawn[0] = 1.0, (-1.0, 0.0)
    return np.broadcast_to(drawn, (steps, CARS, 2)).astype(np.float32)


def test_gymnasium_makes_the_batch(envs):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gymnasium.make_vec(NAME, num_envs=2, engine="hold", task=SEVERAL).close()
    assert isinstance(envs, VectorEnv)
    assert isinstance(envs, WaypointsVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert envs.num_envs == CARS
    assert envs.observation_space.shape == (CARS, 23)
    single = gymnasium.make(NAME, engine="hold", task=SEVERAL)
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space


def test_a_rollout_is_that_of_gymnasiums_loop_over_single_cars():
    """One path, so that a car is set down at the same place after each of its ends."""
    make = partial(WaypointsEnv, "kinematic", task=ONE)
    loop = SyncVectorEnv([make] * 3, autoreset_mode=AutoresetMode.SAME_STEP)
    batch = WaypointsVectorEnv(3, "kinematic", task=ONE)
    assert same(batch.reset(seed=1), loop.reset(seed=1))
    ended = np.zeros((2, 3), int)
    for action in commands(2 * STEPS)[:, :3]:
        ours, theirs = batch.step(action), loop.step(action)
        assert same(ours, theirs)
        ended += np.array(ours[2:4])
    assert ended[1].tolist() == [2, 0, 0]
    assert (ended[0, 1:] >= 1).all()


def same(ours, theirs):
    """Equal keys, shapes, types and flags, and numbers but for rounding; objects one by one."""
    if isinstance(ours, dict):
        return ours.keys() == theirs.keys() and all(same(ours[k], theirs[k]) for k in ours)
    if isinstance(ours, tuple):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if ours is None:
        return theirs is None
    if ours.dtype == object:
        return theirs.dtype == object and all(map(same, ours, theirs))
    alike = ours.dtype == theirs.dtype and ours.shape == theirs.shape
    return alike and np.allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def test_the_comparison_sees_a_difference():
    infos = {"final_obs": np.array([None, np.zeros(2, np.float32)], object)}
    other = {"final_obs": np.array([None, np.ones(2, np.float32)], object)}
    assert same(infos, infos)
    assert not same(infos, other)
    assert not same(infos, infos | {"more": np.zeros(2)})
    assert not same((np.zeros(2, np.float32),), (np.zeros(2),))


def test_a_chosen_path_is_that_of_a_single_car(envs):
    path = np.array([4, 3, 2, 1, 0, 3])
    observation, infos = envs.reset(options={"path": path})
    np.testing.assert_array_equal(infos["path"], path)
    single = gymnasium.make(NAME, engine="kinematic", task=SEVERAL)
    for row, index in zip(observation, path, strict=True):
        np.testing.assert_array_equal(row, single.reset(options={"path": index})[0])
    _, infos = envs.reset(options={"path": 2})
    assert infos["path"].tolist() == [2] * CARS


def test_an_ended_car_begins_anew_in_the_same_step_and_its_last_observation_is_kept(envs):
    envs.reset(seed=0)
    for action in commands(STEPS):
        observation, _, terminated, truncated, infos = envs.step(action)
        ended = terminated | truncated
        assert ("final_obs" in infos) == ended.any()
        if ended.any():
            np.testing.assert_array_equal(infos["_final_obs"], ended)
            np.testing.assert_array_equal(infos["_final_info"], ended)
            np.testing.assert_array_equal(infos["final_info"]["_lateral_error"], ended)
            left = np.abs(infos["final_info"]["lateral_error"]) > 0.1
            np.testing.assert_array_equal(left, terminated)
            assert (infos["lateral_error"][ended] == 0.0).all()
            for index in ended.nonzero()[0]:
                assert infos["final_obs"][index] in envs.single_observation_space
                assert (infos["final_obs"][index] != observation[index]).any()
        assert infos["_path"].all()
        assert observation in envs.observation_space
    assert truncated[0]


def test_a_seed_fixes_the_paths_of_later_episodes_too(envs):
    def drawn(seed):
        found = [envs.reset(seed=seed)[1]["path"]]
        found += [envs.step(action)[4]["path"] for action in commands(STEPS)]
        return np.stack(found)

    np.testing.assert_array_equal(drawn(1), drawn(1))
    assert (drawn(1)[0] != drawn(2)[0]).any()
    assert (drawn(1)[:, 1] != drawn(1)[0, 1]).any()


def test_unseeded_batches_differ(envs):
    other = gymnasium.make_vec(NAME, num_envs=CARS, engine="hold", task=SEVERAL)
    drawn = [[e.reset()[1]["path"].tolist() for _ in range(4)] for e in (envs, other)]
    assert drawn[0] != drawn[1]
    assert drawn[0][0] != drawn[0][1] or drawn[0][0] != drawn[0][2]


def test_what_was_shown_is_not_overwritten_by_the_next_step(envs):
    shown = [envs.reset(seed=0), *(envs.step(action) for action in commands(2))]
    kept = [[np.copy(values) for values in arrays(step)] for step in shown]
    for action in commands(STEPS):
        envs.step(action)
    for step, copies in zip(shown, kept, strict=True):
        assert data_equivalence(tuple(arrays(step)), tuple(copies), exact=True)


def arrays(step):
    """All arrays of what a reset or a step returned."""
    return [*step[:-1], *step[-1].values()]


def test_an_engine_of_the_users_own_has_the_batch():
    engine = make_engine("hold", CARS)
    assert WaypointsVectorEnv(CARS, engine, task=SEVERAL).reset()[0].shape == (CARS, 23)
    with pytest.raises(ValueError, match=r"num_envs is 4, the engine has a batch of \(6,\)"):
        WaypointsVectorEnv(4, make_engine("hold", CARS), task=SEVERAL)


def test_what_is_unknown_or_wrong_is_refused(envs):
    with pytest.raises(TypeError, match="argument 'taks'; did you mean 'task'"):
        gymnasium.make_vec(NAME, num_envs=2, engine="hold", taks=SEVERAL)
    with pytest.raises(RuntimeError, match="call reset first"):
        envs.step(commands(1)[0])
    with pytest.raises(ValueError, match="no option 'paht'; did you mean 'path'"):
        envs.reset(options={"paht": 1})
    with pytest.raises(ValueError, match="path is 5: the task has 5 paths"):
        envs.reset(options={"path": [0, 1, 2, 3, 4, 5]})
    with pytest.raises(ValueError, match="must be an integer, or an array of 6 of them"):
        envs.reset(options={"path": [0, 1]})
    envs.reset()
    with pytest.raises(ValueError, match=r"shape \[5, 2\], not \[6, 2\]"):
        envs.step(commands(1)[0, :5])
