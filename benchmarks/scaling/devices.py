"""Speed of environments, training and rollouts on one device."""

import statistics
import time
from collections.abc import Callable, Iterator
from typing import Any

import torch
from tensordict import TensorDictBase

from buggy_rl.core import keys
from buggy_rl.core.stepping import trajectory
from buggy_rl.policies.training.actor_critic import Policy, PolicyConfig
from buggy_rl.policies.training.ppo import PPO
from buggy_rl.policies.training.ppo_config import PPOConfig
from buggy_rl.task.env import make_env, make_simulator
from engines import make
from scaling.graphs import recorded

COPIED = 64_000_000  # [numbers] 256 MB: more than any cache, so that memory itself is measured
CHUNK = 20  # steps between two looks at the clock
ROLLOUT = 130  # rows of a segment: 0.3 s of warm-up and 1 s, at 100 Hz
SEGMENTS = 60  # of a diagnosis, its default


def synchronised(device: str) -> float:
    """The time [s], when the device has done all that it was given."""
    if device.startswith("cuda"):
        torch.cuda.synchronize()
    return time.perf_counter()


def rate(work: Callable[[], int], device: str, seconds: float, repeats: int) -> float:
    """Median of what `work` counts, a second; the first call warms up."""
    work()
    rates = []
    for _ in range(repeats):
        begun, count = synchronised(device), 0
        while synchronised(device) - begun < seconds:
            count += work()
        rates.append(count / (synchronised(device) - begun))
    return statistics.median(rates)


def bandwidth(device: str, seconds: float) -> float:
    """Bytes a second of a copy, read and written."""
    source = torch.zeros(COPIED, device=device)
    target = torch.empty_like(source)

    def copy() -> int:
        target.copy_(source)
        return 2 * 4 * COPIED

    return rate(copy, device, seconds, 3)


GRAPH = "_graph"
"""Ends the name of an engine whose step is recorded as a CUDA graph."""


def engine_of(name: str, cars: int, device: str) -> Any:
    """A simulator on a device; the MuJoCo car steps on a GPU by MuJoCo Warp."""
    if name.endswith(GRAPH):
        return recorded(engine_of(name.removesuffix(GRAPH), cars, device))
    if name == "learned":
        return make(name, (cars,), device, threads=1)
    if name == "mujoco" and device != "cpu":
        return make_simulator(name, cars, device, backend="warp")
    return make_simulator(name, cars, device)


def bytes_of(state: TensorDictBase) -> int:
    """Of all tensors of a TensorDict."""
    return sum(v.numel() * v.element_size() for v in state.values(True, True))


def environment(name: str, cars: int, device: str, seconds: float, repeats: int) -> dict[str, Any]:
    """Steps a second of a simulator, and what the memory alone would allow.

    The floor: a step reads state and action once and writes the next state once.
    """
    env = engine_of(name, cars, device)
    state = env.reset()
    action = torch.rand(cars, 2, device=device) * 2 - 1
    touched = 2 * bytes_of(state.exclude("done", "terminated")) + bytes_of(
        env.full_action_spec.zero()
    )

    @torch.no_grad()
    def chunk() -> int:
        nonlocal state
        for _ in range(CHUNK):
            state["action"] = action
            _, state = env.step_and_maybe_reset(state)
        return CHUNK * cars

    return {"steps_per_s": rate(chunk, device, seconds, repeats), "bytes_per_step": touched / cars}


def training(name: str, cars: int, device: str, seconds: float, repeats: int) -> dict[str, Any]:
    """PPO steps a second of the whole loop, at the default settings with `cars` environments."""
    torch.manual_seed(0)
    env = make_env(engine_of(name, cars, device))
    policy = Policy(env.observation_spec[keys.OBSERVATION].shape[-1], PolicyConfig())
    config = PPOConfig(steps=1 << 40, cars=cars, schedule="constant")
    batches: Iterator[dict[str, float]] = PPO(env, policy, config).run()

    def batch() -> int:
        next(batches)
        return cars * config.batch_steps

    return {"steps_per_s": rate(batch, device, seconds, repeats)}


def rollouts(name: str, sets: int, device: str, seconds: float, repeats: int) -> dict[str, Any]:
    """Rollouts a second of a diagnosis: parameter sets times segments, by the loop that it uses."""
    cars = sets * SEGMENTS
    env = engine_of(name, cars, device)
    actions = torch.rand(ROLLOUT, cars, 2, device=device) * 2 - 1

    def act(row: int, state: TensorDictBase) -> TensorDictBase:
        return state.set(keys.ACTION, actions[row])

    @torch.no_grad()
    def once() -> int:
        for _ in trajectory(env, env.reset(), act, ROLLOUT):
            pass
        return cars

    return {"rollouts_per_s": rate(once, device, seconds, repeats)}
