"""A controller of the buggy drives similar cars of another size."""

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core.vehicle import Similarity
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.controllers.at_scale import (
    AtScale,
    ManoeuvringDriver,
    RoomAtScale,
    for_car,
    taken_by,
)
from buggy_rl.policies.controllers.path_tracking import PurePursuit, Stanley
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.policies.evaluation.drives import evaluation_task
from buggy_rl.simulators import make_engine
from buggy_rl.task.config import TaskConfig
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig

BRAKES = {"command": "throttle_brake_reverse"}
SPEED = {"command": {"kind": "speed", "reverse": True}}


def seen(length=1.0, speed=1.0):
    """Waypoints that bend to the left, and a velocity, of a car of another size."""
    along = torch.arange(1, 11) * 0.2
    waypoints = torch.stack([along, 0.2 * along**2], -1)[None]
    velocity = torch.tensor([[2.0, 0.05, 0.4]]) * torch.tensor([speed, speed, speed / length])
    return TensorDict({"waypoints": length * waypoints, "velocity": velocity}, [1])


@pytest.mark.parametrize("controller", [PurePursuit(), Stanley()])
def test_a_similar_car_in_a_similar_place_gets_the_same_command(controller):
    buggy = controller(seen())["action"]
    car = AtScale(controller, Similarity(900.0, 15.0, 4.0))(seen(15.0, 4.0))["action"]
    assert torch.allclose(car, buggy, atol=1e-5)
    assert buggy[0, 1] > 0.05  # to the left


def test_what_the_car_sees_is_left_as_it_is():
    given = seen(15.0, 4.0)
    after = AtScale(PurePursuit(), Similarity(900.0, 15.0, 4.0))(given.clone())
    for key in ("waypoints", "velocity"):
        assert torch.equal(after[key], given[key])


def test_without_a_car_the_controller_is_itself():
    assert isinstance(for_car(lambda command: PurePursuit(None, command), ""), PurePursuit)


# 15 s: similar cars need sqrt of the length longer than the buggy.
@pytest.mark.parametrize(
    ("car", "steps", "least"),  # of 51 waypoints a lap
    [
        ("full_size", 500, 5),
        *(pytest.param(c, 1500, 25, marks=pytest.mark.slow) for c in ("autorally", "full_size")),
    ],
)
def test_pure_pursuit_drives_a_lap_of_the_car_s_own_size(car, steps, least):
    task = evaluation_task(TaskConfig(paths=PathConfig(kind="lap", car=car)), steps)
    env = make_env(make_engine("single_track", (2,), car=car), task=task)
    scores = drive(env, for_car(lambda command: PurePursuit(None, command), car), steps).means()
    assert scores["kept_on"] == 1.0
    assert scores["waypoints"] > least


@pytest.mark.parametrize("kind", [RoomDriver, ManoeuvringDriver])
def test_a_driver_about_a_room_gives_the_similar_car_the_same_commands(kind):
    scale = Similarity(64.0, 4.0, 2.0)
    buggy, car = kind(seed=5, dt=0.01), RoomAtScale(kind(seed=5, dt=0.02 / scale.time), scale)
    start, far = buggy.start_pose([3]), car.start_pose([3])
    assert torch.allclose(far, start * torch.tensor([4.0, 4.0, 1.0]))
    moving = torch.tensor([[1.5, 0.1, 0.4], [0.2, 0.0, 0.0], [3.0, -0.2, -1.0]])
    fast = moving * torch.tensor([2.0, 2.0, 0.5])
    for _ in range(300):
        one = buggy(TensorDict({"pose": start.clone(), "velocity": moving}, [3]))["action"]
        other = car(TensorDict({"pose": far.clone(), "velocity": fast}, [3]))["action"]
        assert torch.allclose(one, other, atol=1e-5)


@pytest.mark.parametrize("options", [BRAKES, SPEED], ids=str)
@pytest.mark.parametrize("make", [PurePursuit, pytest.param(Stanley, marks=pytest.mark.slow)])
def test_followers_drive_a_car_with_its_own_kind_of_command(make, options):
    steps = 250
    task = evaluation_task(TaskConfig(paths=PathConfig(kind="lap")), steps)
    engine = make_engine("single_track", (1,), **options)
    env = make_env(engine, task=task)
    scores = drive(
        env, for_car(lambda command: make(None, command), "", taken_by(env)), steps
    ).means()
    assert scores["kept_on"] == 1.0
    assert scores["waypoints"] > 11
    assert taken_by(env).full_speed == (5.0 if options is SPEED else None)
