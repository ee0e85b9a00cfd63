"""A run of policy training: what is driven, what is to be learned, and how it is judged."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from omegaconf import MISSING
from torchrl.envs import TransformedEnv

from buggy_rl.driving import drive
from buggy_rl.engines import make_engine
from buggy_rl.env import TaskConfig, TransformConfig, make_env
from buggy_rl.keys import OBSERVATION
from buggy_rl.paths import make_paths
from buggy_rl.policy import Policy, PolicyConfig
from buggy_rl.ppo import PPOConfig


@dataclass(frozen=True)
class EngineConfig:
    """What is driven; two runs that compare simulators differ in nothing else."""

    simulator: str = "mujoco"
    """An engine's name, a .yaml, a .pt, or file.py:factory."""
    parameters: dict[str, float] = field(default_factory=dict)
    """Physical parameters that differ from the engine's own."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further arguments of the engine's class."""


@dataclass(frozen=True)
class PolicyRunConfig:
    """Everything from a simulator to a policy that drives it."""

    output: str = MISSING
    """Folder for the policy, checkpoints and logs."""
    engine: EngineConfig = field(default_factory=EngineConfig)
    task: TaskConfig = field(default_factory=TaskConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)
    ppo: PPOConfig = field(default_factory=PPOConfig)
    validations: int = 6
    """How often on the way the policy drives the validation paths; the best one is kept."""
    validation_steps: int = 1000
    """Of each such drive."""
    checkpoint_batches: int = 10
    """Batches between two checkpoints."""
    seed: int = 0
    """Fixes starts, exploration and weights; ppo.seed the order of minibatches."""
    threads: int = 1
    """Threads of PyTorch."""
    resume: bool = False
    """Goes on from the last checkpoint in OUTPUT as if never stopped."""
    wandb: bool = False
    """Logs to Weights & Biases too, offline unless WANDB_MODE says otherwise."""


def training_environment(config: PolicyRunConfig) -> TransformedEnv:
    """The cars that a policy learns from."""
    return make_env(_engine(config.engine, config.ppo.cars), task=config.task)


def validation_environment(config: PolicyRunConfig) -> TransformedEnv:
    """One car on each of the validation paths, which training never sees."""
    task = validation_task(config.task)
    paths = make_paths(task.paths)
    return make_env(_engine(config.engine, len(paths)), task=task, paths=paths)


def validation_task(task: TaskConfig) -> TaskConfig:
    """The same task on the validation paths, every car on a path of its own."""
    stack = task.transforms
    waypoints = stack["waypoints"]
    fixed = TransformConfig(waypoints.name, {**waypoints.options, "order": "fixed"})
    paths = replace(task.paths, part="validation")
    return replace(task, paths=paths, transforms={**stack, "waypoints": fixed})


def new_policy(env: TransformedEnv, config: PolicyConfig) -> Policy:
    """A policy for what an environment shows."""
    return Policy(env.observation_spec[OBSERVATION].shape[-1], config)


def validate(env: TransformedEnv, policy: Policy, steps: int) -> dict[str, float]:
    """Means over the validation paths, without exploration and without touching random states."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        scores = drive(env, policy.driver(), steps)
    return {f"validation_{name}": value for name, value in scores.means().items()}


def _engine(config: EngineConfig, cars: int):
    options: Mapping[str, Any] = config.options
    return make_engine(config.simulator, cars, parameters=config.parameters or None, **options)
