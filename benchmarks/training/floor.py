"""The least that a training step costs: the products of model and policy, and nothing else."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from buggy_rl.simulators.learned.engine import LearnedEngine
from training.cases import Ours

Sizes = Sequence[tuple[int, int]]
"""Inputs and outputs of each layer."""
TRIES = 5  # measurements, of which the least counts


def floor(training: Ours, seconds: float) -> dict[str, dict[str, Any]]:
    """Multiply-adds and measured microseconds of each part, for one step of one car."""
    share = seconds / 5  # of the time for each part
    return {
        name: {
            "multiply_adds": round(_adds(sizes, backward) * times),
            "microseconds": _measured(sizes, rows, backward, share) * times,
        }
        for name, sizes, rows, backward, times in _parts(training)
    }


def _parts(training: Ours) -> Iterator[tuple[str, Sizes, int, bool, float]]:
    """Name, layers, rows at once, whether it is differentiated, how often for each step."""
    config, policy = training.ppo.config, training.policy
    engine = getattr(training.ppo.env, "base_env", None)
    if isinstance(engine, LearnedEngine):
        yield "learned engine", _sizes(engine.model), config.cars, False, 1
    actor, critic = _sizes(policy.mean_layers), _sizes(policy.value_layers)
    yield "actor, collecting", actor, config.cars, False, 1
    # V(s_t) and V(s_t+1); the latter is the former a step on, but for where episodes end.
    yield "critic, advantages", critic, config.cars * config.batch_steps, False, 1
    yield "actor, learning", actor, config.minibatch, True, config.epochs
    yield "critic, learning", critic, config.minibatch, True, config.epochs


def _sizes(module: nn.Module) -> list[tuple[int, int]]:
    layers = [layer for layer in module.modules() if isinstance(layer, nn.Linear)]
    return [(layer.in_features, layer.out_features) for layer in layers]


def _adds(sizes: Sizes, backward: bool) -> int:
    """Products once forward; backwards once for the weights and, but in the first, the inputs."""
    forward = sum(inputs * outputs for inputs, outputs in sizes)
    return 3 * forward - sizes[0][0] * sizes[0][1] if backward else forward


def _measured(sizes: Sizes, rows: int, backward: bool, seconds: float) -> float:
    """Microseconds a row, of the products alone into memory that is there."""
    layers = [_Layer(rows, *size, first=i == 0) for i, size in enumerate(sizes)]

    def once() -> None:
        for layer in layers:
            layer.forward()
        for layer in reversed(layers) if backward else ():
            layer.backward()

    once()
    return 1e6 * min(_timed(once, seconds / TRIES) for _ in range(TRIES)) / rows


def _timed(once: Callable[[], None], seconds: float) -> float:
    count, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < seconds:
        once()
        count += 1
    return (time.perf_counter() - begin) / count


class _Layer:
    """The products of a fully connected layer."""

    def __init__(self, rows: int, inputs: int, outputs: int, first: bool) -> None:
        def some(*shape: int) -> Tensor:
            return torch.full(shape, 0.1)

        self.x, self.weight, self.y = some(rows, inputs), some(outputs, inputs), some(rows, outputs)
        self.dx, self.dweight = None if first else some(rows, inputs), some(outputs, inputs)

    def forward(self) -> None:
        torch.mm(self.x, self.weight.t(), out=self.y)

    def backward(self) -> None:
        torch.mm(self.y.t(), self.x, out=self.dweight)
        if self.dx is not None:
            torch.mm(self.y, self.weight, out=self.dx)
