"""Steps of an engine of ours and its effects without TensorDicts, whose checks take longer.

Engines and effects of the package read and write a state by `get`, `set` and `[]` alone, so a
mapping does: the same operations on the same tensors, to the last bit.
"""

from collections.abc import Sequence

from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.effects.base import Effect
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
        self._engine = engine
        self._acting = [effect for effect in stack if effect.active]

    @classmethod
    def of(cls, engine: EnvBase, stack: Sequence[Effect]) -> "BareEnv | None":
        """What stands for an engine of ours under effects of ours.

        None where one is a user's own, which may call what a TensorDict alone has.
        """
        own = all(type(part).__module__.startswith("buggy_rl.") for part in (engine, *stack))
        if own and isinstance(engine, Engine) and type(engine)._step is Engine._step:
            return cls(engine, stack)
        return None

    def step(self, state: Rows) -> dict[str, Rows]:
        """Returns the next state under `next`."""
        before = Rows(state)  # what effects hand to one another stays out of the state
        for effect in reversed(self._acting):
            effect._inv_call(before)  # type: ignore[arg-type]
        after = Rows(self._engine.moved(before))
        for effect in self._acting:
            effect._step(before, after)  # type: ignore[arg-type]
        return {"next": after}
