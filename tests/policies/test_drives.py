"""Drives of policies, on a circle of 1 m radius to the left and a kinematic car."""

from dataclasses import replace

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.core.config import plain_values
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.evaluation.drives import (
    ShowPoliciesConfig,
    evaluation_task,
    policy_panels,
    tracks,
)
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig, save_policy
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import joined_paths

CIRCLE = PathConfig(kind="circle")


def commands(throttle, steering):
    def driver(state):
        action = torch.tensor([throttle, steering]).expand(*state.batch_size, 2)
        return state.set(keys.ACTION, action)

    return driver


def env_of(cars, steps=60):
    paths = joined_paths([make_paths(CIRCLE)] * cars)
    return make_env(
        "kinematic", task=evaluation_task(TaskConfig(), steps), batch_size=cars, paths=paths
    )


def test_a_track_is_the_drive_row_by_row_and_scores_like_it():
    env, driver = env_of(2), commands(0.4, 0.4)
    both = tracks(env, driver, [60, 60])
    scores = drive(env_of(2), driver, 60)
    for index, track in enumerate(both):
        kept = int(60 * scores.kept_on[index]) + 1
        assert track.pose.shape == track.velocity.shape == (kept, 3)
        assert not track.pose[0].any()
        assert track.waypoints == float(scores.waypoints[index])
        assert track.lateral_mean == pytest.approx(float(scores.lateral_mean[index]), rel=1e-5)
    assert both[0].waypoints >= 2


def test_a_track_ends_with_its_episode_or_its_steps():
    # straight on at full throttle leaves the circle by 1 m after some 1.7 m
    gone, short = tracks(env_of(2, 400), commands(1.0, 0.0), [400, 20])
    assert len(short.pose) == 21
    assert 21 < len(gone.pose) < 401
    x, y = gone.pose[-1, :2].tolist()
    assert (x**2 + (y - 1) ** 2) ** 0.5 - 1 == pytest.approx(1.0, abs=0.1)
    assert torch.equal(gone.pose[:21], short.pose)


@pytest.fixture
def policy_file(tmp_path):
    """A policy that has learned nothing, for the last two observations."""
    stack = default_transforms()
    stack["history"] = TransformConfig("history", {"rows": 2})
    task = TaskConfig(paths=PathConfig(count=3, waypoints=40), transforms=stack)
    engine = {"simulator": "kinematic", "parameters": {}, "options": {}}
    file = tmp_path / "best.pt"
    torch.manual_seed(0)
    about = {"config": {"engine": engine, "task": plain_values(task)}}
    save_policy(Policy(46, PolicyConfig(hidden=[4])), file, about)
    return str(file)


@pytest.mark.slow
@pytest.mark.parametrize(
    "courses", [["lap"], pytest.param(["lap", "random"], marks=pytest.mark.slow)], ids=len
)
def test_a_policy_is_shown_in_its_own_simulator_on_its_own_task_and_on_the_car(
    policy_file, courses
):
    config = ShowPoliciesConfig(policies={"mine": policy_file}, car="single_track")
    shown = list(policy_panels(replace(config, courses=courses)))
    assert [(p.policy, p.place, p.course) for p in shown] == [
        ("mine", place, course)
        for place in ("in its simulator", "on the single_track")
        for course in courses
    ]
    lap = shown[0].waypoints
    assert lap.shape == (52, 2)  # 51 and the first again
    assert torch.equal(lap[0], lap[-1])
    assert [p.waypoints.shape for p in shown if p.course == "random"] == [(120, 2)] * (
        2 * (len(courses) - 1)
    )
    for panel in shown:
        assert panel.compared.waypoints > panel.track.waypoints  # pure pursuit gets somewhere
    assert shown[0].compared.waypoints > 40
    assert not torch.equal(shown[0].compared.pose[:99], shown[len(courses)].compared.pose[:99])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"policies": {}}, "no policy to show"),
        ({"courses": ["lap", "square"]}, "name some of lap, infinity, random"),
        ({"policies": {"one": "nowhere.pt"}}, r"no policy file nowhere\.pt"),
    ],
)
def test_what_cannot_be_shown_is_refused(policy_file, change, message):
    config = replace(ShowPoliciesConfig(policies={"mine": policy_file}), **change)
    with pytest.raises(ValueError, match=message):
        list(policy_panels(config))
