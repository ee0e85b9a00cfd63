import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.policies.closed_loop import TrackReset, drive
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig
from tests.policies.test_closed_loop import STEPS, coasting, environment

pytestmark = pytest.mark.usefixtures("without_gradients")

ENGINES = (
    "single_track",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("mujoco", "reference")),
)


def circle(engine: str):
    """Two cars that have to turn to stay within 0.3 m of their path, slipping tyres or not."""
    stack = default_transforms()
    stack["leave_path"] = TransformConfig("leave_path", {"limit": 0.3})
    stack["waypoints"] = TransformConfig("waypoints", {"order": "fixed"})
    return make_env(engine, task=TaskConfig(PathConfig(kind="circle"), stack), batch_size=2)


def straight(state):
    return state.set(keys.ACTION, torch.tensor([-0.3, 0.0]).expand(2, 2))


def test_a_car_is_put_back_as_often_as_it_fails(tmp_path):
    env = environment(tmp_path, limit=0.2)
    track_reset = TrackReset(env, patience=0.3, handling=0.2)
    scores = drive(env, coasting, STEPS, track_reset)
    # Lost at step 1; stands in hands to 20; closes nothing in 21 to 50; and 70 to 99 likewise.
    assert track_reset.times.flatten().tolist() == [3.0, 3.0]
    assert scores.kept_on.tolist() == pytest.approx([0.59, 0.59])


def test_a_car_on_its_path_is_left_alone(tmp_path):
    alone = drive(environment(tmp_path, limit=1.0), coasting, STEPS)
    env = environment(tmp_path, limit=1.0)
    track_reset = TrackReset(env, patience=0.3)
    watched = drive(env, coasting, STEPS, track_reset)
    assert track_reset.times.flatten().tolist() == [0.0, 0.0]
    for name in ("waypoints", "kept_on", "lateral_mean", "speed"):
        assert torch.equal(getattr(watched, name), getattr(alone, name))


@pytest.mark.parametrize("engine", ENGINES)
def test_a_car_that_was_put_back_goes_on_from_the_path(engine: str):
    alone = drive(circle(engine), straight, 300)
    env = circle(engine)
    track_reset = TrackReset(env, handling=0.1)
    watched = drive(env, straight, 300, track_reset)
    assert (track_reset.times > 0).all()
    assert (watched.waypoints > alone.waypoints).all()
    assert (watched.lateral_max < 0.4).all()


@pytest.mark.parametrize("engine", ENGINES)
def test_a_car_in_hands_rests_along_the_path_before_its_next_waypoint(engine: str):
    env = circle(engine)
    track_reset = TrackReset(env, handling=0.5)
    state = env.reset()
    for _ in range(300):
        following = env.step(straight(state))["next"]
        if track_reset(following).all():
            break
        state = following
    assert track_reset.times.flatten().tolist() == [1.0, 1.0]
    for _ in range(20):
        following = env.step(straight(following))["next"]
        track_reset(following)
    assert (following[keys.VELOCITY] == 0).all()
    assert not following[keys.WAYPOINTS_CLOSED].any()
    assert track_reset.times.flatten().tolist() == [1.0, 1.0]
    following = env.step(straight(following))["next"]
    assert (following[keys.LATERAL_ERROR].abs() < 0.02).all()
    assert (following[keys.HEADING_ERROR].abs() < 0.05).all()
    assert (following[keys.WAYPOINTS][:, 0, 0] > 0).all()


def test_without_waypoints_there_is_nowhere_to_put_a_car():
    with pytest.raises(ValueError, match="needs a task with waypoints"):
        TrackReset(make_env("single_track", batch_size=2).base_env)
