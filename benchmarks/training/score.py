"""The time it takes a policy to drive as well as a tuned pure pursuit, or nearly."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torchrl.envs import EnvBase

from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.controllers.path_tracking import PurePursuit, PurePursuitConfig
from buggy_rl.policies.controllers.tuning import TuningConfig, tune
from buggy_rl.policies.training.run import PolicyRunConfig, validation_task
from buggy_rl.task.env import make_env
from buggy_rl.task.paths.making import make_paths
from training.cases import Training, make_simulator, read_settings, validation_environment


@dataclass(frozen=True)
class Climb:
    """How a policy's score rose; the clock ran while it learned, not while it was judged."""

    reached: bool
    seconds: float
    """Of training, to the score or until it was given up."""
    steps: int
    best: float
    """Waypoints closed, the mean over the paths, at the best look."""
    curve: list[tuple[int, float, float]]
    """Steps, seconds and waypoints at each look."""


def climb(
    training: Training,
    simulator: str,
    run: PolicyRunConfig,
    target: float,
    every: int,
    limit: float,
) -> Climb:
    """Trains until the policy closes `target` waypoints of the validation paths.

    Args:
        training: From its beginning.
        simulator: What it is judged in, the same that it is trained in.
        run: What it is judged on.
        target: Waypoints, the mean over the paths.
        every: Steps between two looks; each is after a whole batch.
        limit: Seconds of training after which it is given up.
    """
    env = validation_environment(simulator, torch.get_num_threads(), run)
    curve: list[tuple[int, float, float]] = []
    clock, due, begin = 0.0, every, 0.0

    def watch(steps: int) -> bool:
        nonlocal clock, due, begin
        if steps:
            clock += time.perf_counter() - begin
        if steps >= due or clock >= limit:
            curve.append((steps, clock, score(env, training, run.validation_steps)))
            due = steps + every
        begin = time.perf_counter()
        return clock < limit and not (curve and curve[-1][2] >= target)

    training.train(watch)
    steps, seconds, closed = curve[-1]
    best = max(row[2] for row in curve)
    return Climb(closed >= target, seconds, steps, best, curve)


def score(env: EnvBase, training: Training, steps: int) -> float:
    """Waypoints closed, the mean over the validation paths."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return drive(env, training.driver(), steps).waypoints.mean().item()


def tuned_pursuit(
    simulator: str, threads: int, sources: Sequence[str], candidates: int, seed: int
) -> dict[str, Any]:
    """The pure pursuit that closes most waypoints of the validation paths, tuned on them."""
    run = read_settings(sources, seed)
    task = validation_task(run.task)
    paths = make_paths(task.paths)
    cars = make_simulator(simulator, (candidates * len(paths),), threads)
    env = make_env(cars, task=task, paths=paths)
    start = PurePursuitConfig()
    begin = time.perf_counter()
    _, trials = tune(
        env, len(paths), PurePursuit, start, TuningConfig(run.validation_steps, seed=seed)
    )
    return {**asdict(trials[0]), "seconds": time.perf_counter() - begin}
