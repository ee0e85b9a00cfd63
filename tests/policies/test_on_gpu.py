"""What a GPU computes: training, its resumption, scores and tuning; skipped where there is none."""

from dataclasses import replace
from itertools import islice

import pytest
import torch
from torch.testing import assert_close

from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.controllers.path_tracking import PurePursuit, PurePursuitConfig
from buggy_rl.policies.controllers.tuning import TuningConfig, tune
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.policies.training.run import PolicyRunConfig, new_policy, validation_task
from buggy_rl.task.env import make_env, make_simulator
from buggy_rl.task.paths.making import make_paths

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
CONFIG = PPOConfig(steps=1 << 20, cars=16, batch_steps=8, minibatch=32, epochs=2)


def training(device: str) -> PPO:
    torch.manual_seed(0)
    env = make_env(make_simulator("kinematic", CONFIG.cars, device))
    env.set_seed(0)
    return PPO(env, new_policy(env, PolicyRunConfig().policy), CONFIG)


def test_a_resumed_training_goes_on_as_if_never_stopped():
    whole = training("cuda")
    rows = list(islice(whole.run(), 4))
    first = training("cuda")
    list(islice(first.run(), 2))
    saved = first.state_dict()
    again = training("cuda")
    again.load_state_dict(saved)
    resumed = list(islice(again.run(), 2))
    for row, other in zip(rows[2:], resumed, strict=True):
        assert row["loss_critic"] == pytest.approx(other["loss_critic"], rel=1e-6)
        assert row["reward"] == pytest.approx(other["reward"], rel=1e-6)


def paths_and_env(device: str, each: int = 1):
    task = validation_task(PolicyRunConfig().task)
    paths = make_paths(task.paths)
    engine = make_simulator("kinematic", each * len(paths), device)
    return paths, make_env(engine, task=task, paths=paths)


def test_an_episode_has_the_scores_of_the_cpu():
    found = {}
    for device in ("cpu", "cuda"):
        _, env = paths_and_env(device)
        found[device] = drive(env, PurePursuit(PurePursuitConfig()), 100)
    assert found["cuda"].waypoints.device.type == "cuda"
    assert_close(found["cuda"].waypoints.cpu(), found["cpu"].waypoints, atol=1.0, rtol=0.0)


def test_a_controller_is_tuned_there():
    paths, env = paths_and_env("cuda", each=4)
    search = replace(TuningConfig(), rounds=2, steps=50)
    best, trials = tune(env, len(paths), PurePursuit, PurePursuitConfig(), search)
    assert isinstance(best, PurePursuitConfig)
    assert len(trials) == 8
