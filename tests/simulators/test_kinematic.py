import math

import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.vehicle import shift_pose
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.bicycle.actuation import road_wheel_angle

DIRECT = {"throttle_dead_time": 0, "throttle_lag": 0, "steering_dead_time": 0, "steering_lag": 0}
AT_CG = {"sensor_x": 0, "sensor_y": 0}
FREE = dict.fromkeys(
    (
        "dry_friction",
        "viscous_friction",
        "quadratic_drag",
        "steering_drag",
        "steering_drag_speed",
        "drive_force",
    ),
    0.0,
)


def drive(engine, throttle, steering, steps, vx=0.0):
    start = TensorDict({"velocity": torch.tensor([vx, 0.0, 0.0])})
    state = engine.reset(start, set_state=True)
    poses, velocities = [state["pose"]], [state["velocity"]]
    for _ in range(steps):
        state[keys.ACTION] = torch.tensor([throttle, steering])
        state = engine._step_mdp(engine.step(state))
        poses.append(state["pose"])
        velocities.append(state["velocity"])
    return torch.stack(poses), torch.stack(velocities)


def test_the_wheels_roll_where_they_point():
    car = make_engine("kinematic", parameters={**DIRECT, **AT_CG})
    delta = float(road_wheel_angle(torch.tensor(0.7), car.values))
    _, velocity = drive(car, 0.0, 0.7, 50)
    vx, vy, yaw_rate = velocity[-1].tolist()
    assert yaw_rate == pytest.approx(vx * math.tan(delta) / 0.174, rel=1e-5)
    assert math.atan2(vy, vx) == pytest.approx(math.atan(0.093 / 0.174 * math.tan(delta)), rel=1e-5)


def test_the_rear_axle_runs_on_a_circle_about_the_point_that_the_front_wheels_point_to():
    car = make_engine("kinematic", parameters={**DIRECT, **AT_CG, **FREE})
    delta = float(road_wheel_angle(torch.tensor(1.0), car.values))
    pose, velocity = drive(car, -1.0, 1.0, 400, vx=1.0)
    assert float(velocity[-1, 0]) == 1.0
    rear = shift_pose(pose[1:], -0.093)  # the first step is half without steering
    radius = 0.174 / math.tan(delta)
    normal = torch.stack([-torch.sin(rear[:, 2]), torch.cos(rear[:, 2])], -1)
    centre = rear[:, :2] + radius * normal
    assert rear[-1, 2] > 2 * math.pi  # more than once around
    assert (centre - centre[0]).norm(dim=-1).max() < 2e-3  # m


def test_straight_ahead_it_drives_as_the_single_track_engine():
    kinematic, _ = drive(make_engine("kinematic"), 0.4, 0.0, 200)
    dynamic, _ = drive(make_engine("single_track"), 0.4, 0.0, 200)
    torch.testing.assert_close(kinematic, dynamic, atol=1e-3, rtol=1e-3)
    assert kinematic[-1, 0] > 3.0  # m


def test_at_speed_it_turns_more_than_a_car_with_tyres():
    _, kinematic = drive(make_engine("kinematic"), 0.4, 0.8, 200)
    _, dynamic = drive(make_engine("single_track"), 0.4, 0.8, 200)
    assert kinematic[-1, 2] > 1.5 * dynamic[-1, 2]


def test_it_has_no_tyres_to_fit():
    with pytest.raises(KeyError, match="no parameter front_grip; available: cg_to_front_axle"):
        make_engine("kinematic", parameters={"front_grip": 1.0})
