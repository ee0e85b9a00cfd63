"""Compiled rollouts of `shac`: what they save of a gradient through a learned car, what they cost.

    python -m benchmarks.compiled_rollout model=runs/sample/models/history_mlp.pt

The engine's part alone: `steps` steps of `cars` cars by given commands, and the gradient of speed
and range excess by these commands; with PyTorch's operations, with one step compiled, and with the
whole rollout compiled. PyTorch keeps what it compiled: TORCHINDUCTOR_CACHE_DIR=$(mktemp -d) before
the command compiles anew.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from omegaconf import MISSING
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.config import from_command_line, run
from buggy_rl.simulators import make_engine

Rollout = Callable[..., Tensor]
RANDOM = 0.2  # [-] standard deviation of commands


@dataclass(frozen=True)
class CompiledRolloutConfig:
    """What is rolled out."""

    model: str = MISSING
    """File of a learned car."""
    cars: int = 128
    """Environments, those of `configs/shac.yaml`."""
    steps: int = 24
    """Steps that a gradient passes, likewise."""
    repeats: int = 20
    """Gradients of which the fastest counts."""


def main() -> None:
    """Measures the three ways and prints a table."""
    config = from_command_line(__doc__, "benchmarks.compiled_rollout:CompiledRolloutConfig")
    torch.set_num_threads(1)
    torch.manual_seed(0)
    env = make_engine(config.model, batch_size=config.cars)
    wanted = (keys.POSE, keys.VELOCITY, keys.HISTORY)
    state = {name: value.clone() for name, value in env.reset().items() if name in wanted}
    commands = (RANDOM * torch.randn(config.steps, config.cars, 2)).requires_grad_()
    names = list(state)

    def step(command: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
        after = env.moved({**dict(zip(names, values, strict=True)), keys.ACTION: command})
        return (*(after[name] for name in names), after[keys.RANGE_EXCESS])

    def rollout_by(step: Callable[..., tuple[Tensor, ...]]) -> Rollout:
        def rollout(commands: Tensor, *values: Tensor) -> Tensor:
            total: Any = 0.0
            for command in commands.unbind(0):
                *values, excess = step(command, *values)  # type: ignore[assignment]
                total = total + values[names.index(keys.VELOCITY)][..., 0].sum() + excess.sum()
            return total

        return rollout

    ways = {
        "operations of PyTorch": rollout_by(step),
        "a step compiled": rollout_by(torch.compile(step, dynamic=False)),
        "the rollout compiled": torch.compile(rollout_by(step), dynamic=False),
    }
    print("| way | first gradient [s of CPU] | then [ms of CPU] |")
    print("|---|--:|--:|")
    for name, way in ways.items():
        first, *rest = [_seconds(way, commands, state) for _ in range(2 + config.repeats)]
        print(f"| {name} | {first:.1f} | {1000 * min(rest):.1f} |", flush=True)


def _seconds(way: Rollout, commands: Tensor, state: dict[str, Tensor]) -> float:
    begun = time.process_time()
    way(commands, *state.values()).backward()
    commands.grad = None
    return time.process_time() - begun


if __name__ == "__main__":
    run(main)
