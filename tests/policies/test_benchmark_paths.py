from dataclasses import replace

import torch

from buggy_rl.core import keys
from buggy_rl.policies.evaluation.drives import benchmark_paths, evaluation_task
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.transforms.observation import ObservationNoise

PATHS = PathConfig(waypoints=40, validation_count=3, mirrored=True, placed=True)


def training_task():
    """Cars set down askew on any path, for ever."""
    stack = default_transforms()
    askew = {"start_lateral": 0.3, "start_heading": 0.5, "lateral_bound": 0.4}
    stack["waypoints"] = TransformConfig("waypoints", askew)
    stack["step_limit"] = TransformConfig("step_limit", {"max_steps": 7000})
    return TaskConfig(paths=PATHS, transforms=stack)


def test_the_benchmark_paths_are_the_original_studys():
    named = benchmark_paths(PATHS, random_paths=4)
    assert {name: course.steps for name, course in named.items()} == {
        "training": 1000, "validation": 1000, "lap": 1000, "infinity": 1000, "random": 500,
    }  # fmt: skip
    sizes = {name: len(make_paths(course.paths)) for name, course in named.items()}
    assert sizes == {"training": 4, "validation": 3, "lap": 1, "infinity": 1, "random": 1}
    assert not any(make_paths(course.paths).start.any() for course in named.values())


def test_training_paths_are_the_first_of_those_trained_on():
    few = make_paths(benchmark_paths(PATHS, 4)["training"].paths)
    plain = make_paths(replace(PATHS, mirrored=False, placed=False, count=9))
    assert torch.equal(few.points, plain.points[:4])


def test_every_car_is_judged_on_its_own_path_from_its_start():
    paths = make_paths(benchmark_paths(PATHS, 4)["training"].paths)
    env = make_env("kinematic", task=evaluation_task(training_task(), 5), batch_size=4, paths=paths)
    state = env.reset()
    assert state[keys.PATH].flatten().tolist() == [0, 1, 2, 3]
    assert not state[keys.POSE].any()
    assert env.rollout(9)["next", keys.TRUNCATED].flatten(1).int().argmax(1).tolist() == [4] * 4
    (waypoints,) = [t for t in env.transform if hasattr(t, "lateral_bound")]
    assert waypoints.lateral_bound == 0.4  # what else the task says stays


def test_only_the_car_is_seen_through_a_camera():
    for camera in (False, True):
        task = evaluation_task(training_task(), 5, camera)
        env = make_env("kinematic", task=task, paths=make_paths(PathConfig(kind="lap")))
        assert any(isinstance(t, ObservationNoise) for t in env.transform) == camera
