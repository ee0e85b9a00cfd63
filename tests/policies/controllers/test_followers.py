"""What pure pursuit and Stanley have in common, and what each steers by."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.controllers.path_tracking import (
    PurePursuit,
    PurePursuitConfig,
    Stanley,
    StanleyConfig,
)
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig, make_paths
from buggy_rl.task.paths.path_set import joined_paths
from tests.policies.controllers.test_preview import circle, straight

DRIVERS = [PurePursuit, Stanley]
EXACT = {"delay": 0.0, "understeer": 0.0, "full_lock": 0.36}
LENGTH = VehicleDimensions().wheelbase


def action(driver, waypoints, velocity=(1.0, 0.0, 0.0)):
    velocity = torch.tensor(velocity).expand(*waypoints.shape[:-2], 3)
    state = TensorDict({"waypoints": waypoints, "velocity": velocity}, waypoints.shape[:-2])
    return driver(state)["action"]


def course(*kinds, cars=1, engine="single_track"):
    """So many cars on each path, every episode from its start."""
    stack = default_transforms()
    stack["waypoints"] = TransformConfig("waypoints", {"order": "fixed"})
    paths = joined_paths([make_paths(PathConfig(kind=kind)) for kind in kinds])
    size = cars * len(kinds)
    return make_env(engine, task=TaskConfig(transforms=stack), batch_size=size, paths=paths)


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_straight_is_driven_straight(driver):
    assert action(driver(), straight())[1].abs() < 1e-6


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_mirror_image_is_driven_in_mirror_image(driver):
    generator = torch.Generator().manual_seed(0)
    wobble = 0.05 * torch.randn(20, 10, 2, generator=generator).cumsum(1)
    path = straight() + wobble
    flip = torch.tensor([1.0, -1.0])
    one = action(driver(), path, (1.5, 0.2, 1.0))
    other = action(driver(), path * flip, (1.5, -0.2, -1.0))
    torch.testing.assert_close(other, one * flip, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_path_to_the_left_is_steered_to(driver):
    offset = torch.tensor([0.0, 0.2])
    assert action(driver(), straight() + offset)[1] > 0.05
    assert action(driver(), straight() - offset)[1] < -0.05


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_car_pointing_off_the_path_is_steered_back(driver):
    turned = straight() @ torch.tensor(
        [[math.cos(0.3), math.sin(0.3)], [-math.sin(0.3), math.cos(0.3)]]
    )
    assert action(driver(), turned)[1] > 0.1  # the path leads to the left


def test_pure_pursuit_steers_the_kinematic_angle_of_the_circle_it_is_on():
    # The rear axle is on a circle of 1 m and along it: delta = atan(L / R) wherever it looks.
    rear = VehicleDimensions().sensor_to_cg + VehicleDimensions().cg_to_rear_axle
    path = circle(1.0, first=0.25) - torch.tensor([rear, 0.0])
    for look_ahead in (0.5, 0.7, 0.9):
        driver = PurePursuit(PurePursuitConfig(shortest=look_ahead, seconds=0.0, **EXACT))
        expected = math.atan(LENGTH) / 0.36
        assert action(driver, path)[1] == pytest.approx(expected, rel=0.05), look_ahead


def test_pure_pursuit_looks_further_ahead_at_speed():
    # 0.2 m beside a straight, x^2 + y^2 = l^2: kappa = 2 y / l^2 with l = 0.4 + 0.2 v
    rear = VehicleDimensions().sensor_to_cg + VehicleDimensions().cg_to_rear_axle
    path = straight() + torch.tensor([-rear, 0.2])
    driver = PurePursuit(PurePursuitConfig(shortest=0.4, seconds=0.2, **EXACT))
    for speed in (0.0, 1.0, 3.0):
        bend = 2 * 0.2 / (0.4 + 0.2 * speed) ** 2
        expected = min(math.atan(LENGTH * bend) / 0.36, 1.0)
        assert action(driver, path, (speed, 0.0, 0.0))[1] == pytest.approx(expected, rel=1e-3)


def test_pure_pursuit_far_off_its_path_heads_for_the_nearest_point():
    path = straight() + torch.tensor([0.0, 3.0])
    found = action(PurePursuit(), path, (0.0, 0.0, 0.0))
    assert torch.isfinite(found).all()
    assert found[1] > 0.1


def test_stanley_steers_by_heading_and_distance():
    config = StanleyConfig(gain=2.0, softening=1.0, yaw_damping=0.0, **EXACT)
    # 0.1 m to the right of a straight at 1 m/s: atan(2 * 0.1 / 2) = 0.0997 rad
    offset = straight() + torch.tensor([0.0, 0.1])
    assert action(Stanley(config), offset)[1] == pytest.approx(0.0997 / 0.36, rel=1e-3)


def test_stanley_on_a_circle_steers_what_the_circle_needs():
    # The rear axle is on the circle and along it. The point nearest to the front axle is where
    # the line from the centre through it meets the circle: its heading there is atan(L / R).
    rear = VehicleDimensions().sensor_to_cg + VehicleDimensions().cg_to_rear_axle
    path = circle(1.0, first=0.25) - torch.tensor([rear, 0.0])
    config = StanleyConfig(gain=0.0, yaw_damping=0.0, **EXACT)
    plain = action(Stanley(config), path)[1]
    assert plain == pytest.approx(math.atan(LENGTH) / 0.36, rel=0.05)
    # a car at 1 m/s that does not turn yet, v kappa - r = 1 rad/s: 0.1 rad more
    damped = action(Stanley(replace(config, yaw_damping=0.1)), path)[1]
    assert damped - plain == pytest.approx(0.1 / 0.36, rel=0.02)
    # one that slips: L K kappa v^2 = 0.174 * 0.2 rad more
    slipping = action(Stanley(replace(config, understeer=0.2)), path)[1]
    assert slipping - plain == pytest.approx(LENGTH * 0.2 / 0.36, rel=0.02)


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("engine", ["kinematic", "single_track"])
def test_lap_and_infinity_are_driven_fast_and_close(driver, engine):
    score = drive(course("lap", "infinity", engine=engine), driver(), 300)
    assert (score.kept_on == 1).all()
    assert (score.waypoints > 20).all()  # 4 m in 3 s from rest
    assert (score.lateral_rms < 0.08).all()


def test_a_driver_is_a_policy_for_a_rollout():
    rows = course("lap").rollout(100, policy=PurePursuit())
    assert rows["next", keys.VELOCITY][0, -1, 0] > 1.0
