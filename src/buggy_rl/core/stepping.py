"""The loop that steps an environment, and what it begins at; every rollout but a collector's."""

from collections.abc import Callable, Iterator
from typing import Any, Protocol

import torch
from tensordict import TensorDictBase

Act = Callable[[int, TensorDictBase], TensorDictBase]
"""Returns the state to step from: the one it is given, at step 0, 1, ..., with `action` set and,
where motion is imposed, `pose` and `velocity`."""


class Stepped(Protocol):
    """An `EnvBase`, or what is stepped like one."""

    def step(self, state: Any, /) -> Any:
        """Returns the next state under `next`."""


def reset_at(env: Any, state: TensorDictBase) -> TensorDictBase:
    """State [*batch] right after a reset at what is given of it, such as `pose` and `velocity`.

    TorchRL wants `set_state` said; an environment that does not know it begins there anyway.
    """
    flag = {"set_state": True} if getattr(env, "_supports_set_state", False) else {}
    return env.reset(state, **flag)


@torch.no_grad()
def trajectory(
    env: Stepped, state: TensorDictBase, act: Act, steps: int
) -> Iterator[TensorDictBase]:
    """Yields the state before each step and the last one: `steps + 1` in all.

    x_0 = state,  x_{k+1} = env.step(act(k, x_k))["next"],  k = 0 .. steps - 1.

    `act` sees x_k after it was yielded. Where it edits x_k in place and returns it, x_k holds its
    action once the next state has been asked for, so `itertools.pairwise(trajectory(...))` yields
    (x_k with its action, x_{k+1}). Clone what has to outlive that.

    Args:
        env: Environment with batch shape B.
        state: Start x_0, of batch shape B; from `env.reset`.
        act: Sets the action [B, 2] of each step.
        steps: Number of steps.
    """
    yield state
    for row in range(steps):
        state = env.step(act(row, state))["next"]
        yield state
