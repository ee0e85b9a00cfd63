"""The task at the size of another car."""

import inspect

import pytest
import torch

from buggy_rl.core.car_file import load_car
from buggy_rl.core.config import build, load_named
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import UNITS, make_env, scaled_task
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.transforms import TRANSFORMS

SMALL = {"count": 3, "validation_count": 2, "waypoints": 30}


@pytest.mark.parametrize("name", UNITS)
def test_the_defaults_are_those_of_the_classes(name):
    takes = inspect.signature(load_named(TRANSFORMS[name])).parameters
    for option, (default, _) in UNITS[name].items():
        assert takes[option].default == default


@pytest.mark.parametrize("kind", ["simplex", "lap", "infinity", "circle", "tight"])
def test_paths_of_a_car_are_those_of_the_buggy_times_its_length(kind):
    buggy = make_paths(PathConfig(kind=kind, **SMALL))
    car = make_paths(PathConfig(kind=kind, car="full_size", **SMALL))
    length = load_car("full_size").similarity.length
    # A random path chases noise in steps of its spacing: equal but for rounding.
    assert torch.allclose(car.points / length, buggy.points, atol=1e-3)


def test_placed_paths_fill_the_room_of_the_car():
    car = make_paths(PathConfig(kind="circle", car="full_size", placed=True, seed=3))
    buggy = make_paths(PathConfig(kind="circle", placed=True, seed=3))
    length = load_car("full_size").similarity.length
    assert torch.allclose(car.start[:, :2] / length, buggy.start[:, :2], atol=1e-3)


def test_bounds_speeds_and_weights_of_the_transforms_scale():
    task = build(
        TaskConfig,
        [
            "paths.car=full_size",
            "transforms.waypoints.options.lateral_bound=0.4",
            "transforms.rewards.options.weights={waypoints_closed: 1.0, deviation: 0.5}",
        ],
    )
    scale = load_car("full_size").similarity
    transforms = scaled_task(task).transforms
    assert transforms["waypoints"].options["lateral_bound"] == pytest.approx(0.4 * scale.length)
    assert transforms["leave_path"].options["limit"] == pytest.approx(scale.length)
    weights = transforms["rewards"].options["weights"]
    assert weights["waypoints_closed"] == 1.0
    assert weights["deviation"] == pytest.approx(0.5 / scale.length)
    assert transforms["clip"].options["high"][0] == pytest.approx(3.5 * scale.speed)


def test_without_a_car_the_task_is_the_same_object():
    task = TaskConfig()
    assert scaled_task(task) is task


def test_a_full_size_car_closes_waypoints_of_its_own_size():
    task = TaskConfig(paths=PathConfig(kind="lap", car="full_size"))
    from buggy_rl.simulators import make_engine

    env = make_env(make_engine("single_track", (1,), car="full_size"), task=task)
    state, closed = env.reset(), 0.0
    for _ in range(600):  # 6 s straight on: the lap begins with 30 m of straight
        state["action"] = torch.tensor([[0.2, 0.0]])
        state = env.step(state)["next"]
        closed += float(state["reward"])
        if bool(state["done"]):
            break
    assert closed >= 3  # one each 3 m
