"""Policies for the worst share of a posterior: waypoints over held-out draws of the car.

    python -m benchmarks.worst_of_posterior model=runs/sample/models/ensemble_of_history_mlps.pt

Each of the 128 cars of a training has its own draw of the effects over a learned simulator, evenly
from `spread`. A policy is trained by `algorithm: shac` with each share of `worst`; then it drives
the ten validation paths with each of 100 other draws, the same for all policies. A row a training
in `output`; run again, trainings that are in it are not repeated. `begun` steps of a training are
with all cars, in a training of their own (`start=POLICY.pt`).
"""

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from benchmarks.first_order import append, read
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core.config import build, from_command_line, run
from buggy_rl.effects import make_effects
from buggy_rl.jobs.bar import tqdm
from buggy_rl.policies.closed_loop import drive
from buggy_rl.policies.training.actor_critic import Policy
from buggy_rl.policies.training.run import PolicyRunConfig, new_policy, validation_task
from buggy_rl.policies.training.shac import LATEST, SHAC
from buggy_rl.simulators import make_engine
from buggy_rl.task.env import make_env, with_effects

HELD_OUT = 12345  # seed of the draws that judge
PATHS = 10  # for validation
QUARTER = 0.25
SPREAD = {
    "steering_dead_time": {"dead_time": [0.001, 0.25]},
    "steering_gain": {"gain": [0.6, 1.6]},
}
COLUMNS = ("worst", "begun", "seed", "steps", "cpu_seconds", "mean", "worst_tenth", "kept_on")
RANKED = ("by_one_batch", "by_means")


@dataclass(frozen=True)
class WorstConfig:
    """What is trained on which cars."""

    model: str = "runs/sample/models/ensemble_of_history_mlps.pt"
    """A learned simulator."""
    spread: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    """Effect -> parameter -> ends of the interval that it is drawn from; empty for `SPREAD`."""
    worst: list[float] = field(default_factory=lambda: [1.0, 0.25])
    """Shares of the cars that the actor follows, a training each."""
    begun: int = 0
    """Steps with all cars before `steps`."""
    steps: int = 300_000
    """Steps of a training."""
    seeds: list[int] = field(default_factory=lambda: [0, 1, 2])
    draws: int = 100
    """Cars that judge."""
    ranking: bool = False
    """Whether the training's cars are judged too: the share of their worst quarter that is found in
    the lowest quarter of one batch, and of the running means, over the second half."""
    output: str = "runs/worst_of_posterior.csv"
    """Rows, appended."""


def main() -> None:
    """Trains what is left, and prints all rows."""
    config = from_command_line(__doc__, "benchmarks.worst_of_posterior:WorstConfig")
    torch.set_num_threads(1)
    file = Path(config.output)
    known = {(float(row["worst"]), int(row["begun"]), int(row["seed"])) for row in read(file)}
    asked = [(worst, config.begun, seed) for seed in config.seeds for worst in config.worst]
    for one in tqdm([one for one in asked if one not in known], "training", unit="policy"):
        append(file, [trained(config, one[0], one[2])], (*COLUMNS, *RANKED))
    for row in read(file):
        print("  ".join(f"{column} {value}" for column, value in row.items() if value))


def trained(config: WorstConfig, worst: float, seed: int) -> dict[str, Any]:
    """The row of one training."""
    asked = build(PolicyRunConfig, ["configs/shac.yaml", "output=unused", f"shac.seed={seed}"])
    torch.manual_seed(seed)
    values = drawn(config, asked.shac.cars)
    env = make_env(cars(config, values), task=asked.task)
    policy, means = new_policy(env, asked.policy), []
    begun = time.process_time()
    for share, steps in ((1.0, config.begun), (worst, config.steps)):
        settings = replace(asked.shac, steps=steps, worst=share)
        trainer = SHAC(env, policy, settings)
        means = [trainer.surprise.clone() for _ in trainer.run()]
    spent = time.process_time() - begun
    torch.manual_seed(HELD_OUT)
    waypoints, kept = judged(config, policy, asked, drawn(config, config.draws))
    lowest = waypoints.sort().values[: max(1, config.draws // 10)]
    row = {"worst": worst, "begun": config.begun, "seed": seed, "steps": config.steps}
    row |= {"cpu_seconds": round(spent, 1), "mean": round(waypoints.mean().item(), 1)}
    row |= {"worst_tenth": round(lowest.mean().item(), 1), "kept_on": round(kept.item(), 3)}
    if config.ranking and worst < 1.0:
        own, _ = judged(config, policy, asked, values)
        row |= ranked(torch.stack(means), own)
    return row


def drawn(config: WorstConfig, count: int) -> dict[str, dict[str, Tensor]]:
    """Effect -> parameter -> a value [count] for each car."""
    return {
        name: {p: low + (high - low) * torch.rand(count) for p, (low, high) in ends.items()}
        for name, ends in (config.spread or SPREAD).items()
    }


def cars(config: WorstConfig, values: dict[str, dict[str, Tensor]], times: int = 1) -> EnvBase:
    """The learned simulator with these effects, `times` cars of each value after one another."""
    means = {n: {p: v.mean().item() for p, v in own.items()} for n, own in values.items()}
    effects, count = [], 0
    for effect in make_effects(means):
        own = {p: v.repeat_interleave(times) for p, v in values[effect.name].items()}
        count = len(next(iter(own.values())))
        effects.append(effect.with_parameters(TensorDict(own, [count])))
    return with_effects(make_engine(config.model, count), effects)


def judged(
    config: WorstConfig,
    policy: Policy,
    asked: PolicyRunConfig,
    values: dict[str, dict[str, Tensor]],
) -> tuple[Tensor, Tensor]:
    """Waypoints [draws] on average over the validation paths, and the mean share kept on them."""
    env = make_env(cars(config, values, PATHS), task=validation_task(asked.task))
    torch.manual_seed(0)
    scores = drive(env, policy.driver(), asked.validation_steps)
    return scores.waypoints.reshape(-1, PATHS).mean(-1), scores.kept_on.mean()


def ranked(means: Tensor, waypoints: Tensor) -> dict[str, float]:
    """Shares of the worst quarter by waypoints that lie in the lowest quarter of what ranks.

    Args:
        means: [batches, cars] running means.
        waypoints: [cars] of the trained policy.
    """
    count = round(QUARTER * len(waypoints))
    truly = waypoints.topk(count, largest=False).indices
    latest = (means[1:] - (1 - LATEST) * means[:-1]) / LATEST
    found: dict[str, float] = {}
    for name, rank in zip(RANKED, (latest, means[1:]), strict=True):
        lowest = rank[len(rank) // 2 :].topk(count, largest=False).indices  # (batches, count)
        found[name] = round(torch.isin(lowest, truly).float().mean().item(), 2)
    return found


if __name__ == "__main__":
    run(main)
