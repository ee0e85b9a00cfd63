"""Policies as training leaves them, with weights that drew commands all over their range."""

from dataclasses import replace

import torch

from buggy_rl.core import keys
from buggy_rl.core.config import plain_values
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig, save_policy
from buggy_rl.policies.training.run import EngineConfig, PolicyRunConfig, new_engine, new_policy
from buggy_rl.task.config import TaskConfig, TransformConfig, default_transforms
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import PathConfig

GAIN = 60.0  # of the last layer, which begins 0.01 times as large as the others


def task(**places):
    """The default task on two short paths, with some places filled otherwise."""
    stack = default_transforms()
    stack["leave_path"] = TransformConfig("leave_path", {"limit": 5.0})  # [m] drives are longer
    return TaskConfig(paths=PathConfig(count=2, waypoints=60), transforms={**stack, **places})


def policy_file(folder, task, simulator="kinematic", **config):
    """A policy file like best.pt, of a policy that has seen observations of its task."""
    torch.manual_seed(0)
    engine = EngineConfig(simulator=simulator)
    run = PolicyRunConfig(str(folder), engine, task, PolicyConfig(**config), seed=7)
    env = make_env(new_engine(engine, 8), task=task)
    policy = new_policy(env, run.policy)
    with torch.no_grad():
        policy.mean_layers[-1].weight *= GAIN
        policy.observe(_observations(env, policy))
    folder.mkdir(parents=True, exist_ok=True)
    save_policy(policy, folder / "best.pt", {"config": plain_values(run), "steps": 1000})
    return folder / "best.pt"


def _observations(env, policy: Policy):
    """[32, 8, size] of random driving."""
    rollout = env.rollout(32, break_when_any_done=False)
    return rollout[keys.OBSERVATION]


def stack(**places):
    """Named places of a task from (name, options)."""
    return task(**{place: TransformConfig(*about) for place, about in places.items()})


def without(config, place):
    """A task without the transform at a place."""
    return replace(config, transforms={**config.transforms, place: TransformConfig()})
