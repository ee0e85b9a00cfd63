"""Rollouts of an engine of ours and its effects without TensorDicts, which take longer than a step.

Engines and effects of the package read and write a state by `get`, `set` and `[]` alone, so a
mapping does: the same operations on the same tensors, to the last bit.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.effects.base import Effect
from buggy_rl.simulators.base import Engine


class Rows(dict[str, Tensor]):
    """A state, of a batch of environments."""

    def set(self, key: str, value: Tensor) -> "Rows":
        """Sets a value, as a TensorDict does."""
        self[key] = value
        return self


def reads_mappings(engine: Engine, stack: Sequence[Effect]) -> bool:
    """Whether all are the package's; a user's own may call what a TensorDict alone has."""
    own = all(type(part).__module__.startswith("buggy_rl.") for part in (engine, *stack))
    return own and type(engine)._step is Engine._step


@torch.no_grad()
def bare_trajectory(
    engine: Engine,
    stack: Sequence[Effect],
    state: TensorDictBase,
    act: Callable[[int, Any], Any],
    steps: int,
) -> Iterator[Any]:
    """`core.stepping.trajectory` of an engine under effects, whose states are `Rows`.

    Args:
        engine: The simulator.
        stack: Effects from the engine outwards.
        state: Start, from a reset of both.
        act: Sets the action of each step, and returns the state.
        steps: Number of steps.
    """
    acting = [effect for effect in stack if effect.active]
    rows = Rows(state.items())
    yield rows
    for number in range(steps):
        before = Rows(act(number, rows))  # what effects hand to one another stays out of the state
        for effect in reversed(acting):
            effect._inv_call(before)  # type: ignore[arg-type]
        rows = Rows(engine.moved(before))
        for effect in acting:
            effect._step(before, rows)  # type: ignore[arg-type]
        yield rows
