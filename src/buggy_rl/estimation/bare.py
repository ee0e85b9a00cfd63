"""Steps of an engine of ours and its effects without TensorDicts, whose checks take longer.

Engines and effects of the package read and write a state by `get`, `set` and `[]` alone, so a
mapping does: the same operations on the same tensors, to the last bit.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.effects.base import Effect
from buggy_rl.effects.motion.base import MotionEffect, step_together
from buggy_rl.simulators.base import Engine


class Rows(dict[str, Tensor]):
    """A state, of a batch of environments."""

    def set(self, key: str, value: Tensor) -> "Rows":
        """Sets a value, as a TensorDict does."""
        self[key] = value
        return self


class BareEnv:
    """An engine under effects as `core.stepping.trajectory` steps it; its states are `Rows`.

    Args:
        engine: The simulator.
        stack: Effects from the engine outwards.
    """

    def __init__(self, engine: Engine, stack: Sequence[Effect]) -> None:
        self._engine, self._stack, self.device = engine, stack, engine.device
        self.imposed = False
        """Whether the motion after the next step is replaced, so that latent states alone count."""
        self._acting = [effect for effect in stack if effect.active]
        self._steps = list(_passes(self._acting))
        self._latent = list(_passes(_remembered(self._acting, engine.batch_size.numel())))

    @classmethod
    def of(cls, engine: EnvBase, stack: Sequence[Effect]) -> "BareEnv | None":
        """What stands for an engine of ours under effects of ours.

        None where one is a user's own, which may call what a TensorDict alone has.
        """
        own = all(type(part).__module__.startswith("buggy_rl.") for part in (engine, *stack))
        if own and isinstance(engine, Engine) and type(engine)._step is Engine._step:
            return cls(engine, stack)
        return None

    def reset(self, given: TensorDictBase) -> TensorDictBase:
        """State right after a reset at what is given of it."""
        state = self._engine._begin(given, None)
        for effect in self._stack:
            effect._reset(given, state)
        return state

    def step(self, state: Rows) -> dict[str, Rows]:
        """Returns the next state under `next`."""
        before = Rows(state)  # what effects hand to one another stays out of the state
        for effect in reversed(self._acting):
            effect._inv_call(before)  # type: ignore[arg-type]
        after = Rows(self._engine.moved(before))
        for step in self._latent if self.imposed else self._steps:
            step(before, after)
        return {"next": after}


def _remembered(effects: Sequence[Effect], count: int) -> list[Effect]:
    """Effects that have a latent state, and those whose motion or reading such a one sees.

    Args:
        effects: From the engine outwards.
        count: Environments.
    """
    seen = torch.zeros(count, dtype=torch.bool)  # by an effect with a latent state
    kept = list[Effect]()
    for effect in reversed(effects):
        rows = slice(None) if effect.rows is None else effect.rows.cpu()
        remembers = bool(effect._state_specs(torch.Size([1]), None))
        if remembers or bool(seen[rows].any()):
            kept.append(effect)
        if remembers and effect.kind != "actuation":  # a command's is of what was commanded
            seen[rows] = True
    return kept[::-1]


def _passes(effects: Iterable[Effect]) -> Iterator[Callable[[Any, Any], object]]:
    """Steps of effects in their order; of motion effects on separate rows all in one pass."""
    for car, run in groupby(effects, _car):
        for apart in [[effect] for effect in run] if car is None else _separate(run):
            if len(apart) == 1:
                yield apart[0]._step
            else:
                rows = torch.cat([effect._tensor("active_rows") for effect in apart])
                yield partial(step_together, apart, rows)


def _car(effect: Effect) -> object:
    """What motion effects must have in common for one pass; None of one that has its own."""
    if not isinstance(effect, MotionEffect) or effect.rows is None:
        return None
    if type(effect)._write_step is not MotionEffect._write_step:
        return None
    return effect.dimensions, effect.dt


def _separate(effects: Iterable[Any]) -> list[list[Any]]:
    """Effects in few groups of separate rows; of two in the same row the first is earlier."""
    groups: list[list[Any]] = []
    following = torch.zeros(0, dtype=torch.long)  # group of the next effect, for each row
    for effect in effects:
        most = int(effect.rows.max()) + 1
        following = torch.cat([following, following.new_zeros(max(0, most - len(following)))])
        number = int(following[effect.rows].max())
        following[effect.rows] = number + 1
        groups += [[] for _ in range(number + 1 - len(groups))]
        groups[number].append(effect)
    return groups
