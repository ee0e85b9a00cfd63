"""The single-car path through dm_control and TorchRL's wrapper."""

import pytest
import torch
from dm_control.mujoco import Physics
from torchrl.envs import DMControlWrapper
from torchrl.envs.utils import check_env_specs

from buggy_rl.core import keys
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.mujoco import MujocoEngine
from buggy_rl.simulators.mujoco.task import DriveTask, make_environment
from buggy_rl.task.env import make_env

CHANGED = {"mass": 1.9, "cg_to_front_axle": 0.09, "steering_offset": 0.02, "grip_rear": 0.7}


def actions(steps):
    time = torch.arange(steps) * 0.01
    return torch.stack([0.5 * torch.sin(5 * time), torch.cos(7 * time)], -1)


def drive(env, state, steps):
    poses, velocities = [], []
    for action in actions(steps):
        state = env.step(state.set("action", action.expand(*env.batch_size, 2).clone()))["next"]
        poses.append(state[keys.POSE])
        velocities.append(state[keys.VELOCITY])
    return torch.stack(poses), torch.stack(velocities)


@pytest.mark.parametrize("tyres", ["explicit", "contact"])
def test_one_car_through_dm_control_drives_as_the_batched_engine_to_the_last_bit(tyres):
    single = DMControlWrapper(make_environment(CHANGED, tyres=tyres))
    batched = MujocoEngine(3, parameters=CHANGED, tyres=tyres)
    poses, velocities = drive(single, single.reset(), 150)
    several_poses, several_velocities = drive(batched, batched.reset(), 150)
    for car in range(3):
        assert torch.equal(several_poses[:, car], poses)
        assert torch.equal(several_velocities[:, car], velocities)
    assert poses[-1, :2].norm() > 0.2  # m: it went somewhere


def test_the_wrapper_keeps_its_specs():
    env = DMControlWrapper(make_environment())
    check_env_specs(env)
    assert env.action_spec.shape == (2,)


def test_a_second_episode_is_the_first_one_again():
    env = DMControlWrapper(make_environment())
    first, _ = drive(env, env.reset(), 30)
    second, _ = drive(env, env.reset(), 30)
    assert torch.equal(first, second)


def test_episodes_start_where_the_task_says_and_end_at_the_time_limit():
    task = DriveTask(pose=(1.0, 2.0, 0.5), velocity=(1.5, 0.0, 0.0))
    environment = make_environment(task=task, time_limit=0.05)
    observation = environment.reset().observation
    assert observation[keys.POSE] == pytest.approx([1.0, 2.0, 0.5])
    assert observation[keys.VELOCITY] == pytest.approx([1.5, 0.0, 0.0])
    ends = [environment.step([0.0, 0.0]).last() for _ in range(5)]
    assert ends == [False, False, False, False, True]


def test_as_a_simulator_it_is_refused_and_the_engine_named():
    words = "remembers what is not in the TensorDict; .* take the engine 'mujoco'"
    with pytest.raises(ValueError, match=words):
        make_engine(lambda batch_size, device: DMControlWrapper(make_environment()), 4)


def test_the_model_is_read_through_dm_control_physics():
    physics = make_environment().physics
    assert isinstance(physics, Physics)
    assert physics.named.model.body_mass["front_left"] == pytest.approx(0.03)


def test_an_unknown_parameter_is_refused_with_those_there_are():
    with pytest.raises(KeyError, match=r"no parameter colour; available: .*mass"):
        make_environment({"colour": 1.0})


def test_a_task_over_it_is_refused_too():
    with pytest.raises(ValueError, match="DMControlWrapper"):
        make_env(DMControlWrapper(make_environment()))
