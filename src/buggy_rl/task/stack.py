"""An engine under a stack of transforms, whose environments begin and move one by one."""

from collections.abc import Sequence
from itertools import takewhile
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import (
    Compose,
    EnvBase,
    InitTracker,
    RewardSum,
    StepCounter,
    Transform,
    TransformedEnv,
)

from buggy_rl.core import keys
from buggy_rl.simulators.resets import (
    RESET,
    STEP,
    ResettableEnv,
    begun,
    held,
    rows_of,
    spread,
)

REMEMBERING = {StepCounter: "step_count_keys", RewardSum: "out_keys", InitTracker: "out_keys"}
"""Transforms of TorchRL all of whose memory is in the TensorDict, and their list of its keys."""


class StackedEnv(ResettableEnv, TransformedEnv):
    """TorchRL's `TransformedEnv` over a simulator, by the protocol of an engine.

    A reset of some environments computes these alone, from the engine up to the first transform
    that needs the whole batch: one of TorchRL's, or an effect with a value for each environment.
    With `set_state=True` transforms, too, go on from what the TensorDict holds of their state.
    """

    def _begin(self, given: TensorDictBase, rows: Tensor | None) -> TensorDictBase:
        parts = self._parts()
        if rows is None:
            return self._begun(given, parts, None)
        alone = list(takewhile(resets_alone, parts))
        behind = parts[len(alone) :]
        if any(_prepares(part) for part in behind):
            return rows_of(self._begun(self._wide(given, rows), parts, None), rows)
        given = self._marked(given, rows).set(keys.ENVIRONMENT, rows.unsqueeze(-1))
        state = self._begun(given, alone, rows)
        if behind:
            wide, state = self._wide(given, rows), spread(state, rows, self.batch_size)
            for part in behind:
                state = part._reset(wide, state)
            state = rows_of(self._going_on(wide, state), rows)
        return state

    def _begun(
        self, given: TensorDictBase, parts: Sequence[Transform], rows: Tensor | None
    ) -> TensorDictBase:
        """State [*batch], or [k] of `rows`, as far as these transforms."""
        for part in reversed(parts):
            given = part._reset_env_preprocess(given)
        state = begun(self.base_env, given, rows)
        for part in parts:
            state = part._reset(given, state)
        return self._going_on(given, state)

    def _wide(self, given: TensorDictBase, rows: Tensor) -> TensorDictBase:
        """What `rows` are to begin at, in the shape of the batch, with the mask of the reset."""
        return spread(self._marked(given, rows), rows, self.batch_size)

    def _marked(self, given: TensorDictBase, rows: Tensor) -> TensorDictBase:
        """What `rows` [k] are to begin at, with the mask of the reset and their counts of steps."""
        flag = torch.ones((len(rows), 1), dtype=torch.bool, device=rows.device)
        given = given.copy().set(RESET, flag)
        for part in self._parts():  # else it takes a count of the whole batch
            for key in part.step_count_keys if isinstance(part, StepCounter) else ():
                if given.get(key, None) is None:
                    given.set(key, torch.zeros(flag.shape, dtype=torch.int64, device=rows.device))
        return given

    def _going_on(self, given: TensorDictBase, state: TensorDictBase) -> TensorDictBase:
        """A state with the memory of TorchRL's transforms where a reset was given it."""
        return state.update(given.select(*self._remembered(), strict=False))

    def _remembered(self) -> list[Any]:
        lists = [
            getattr(part, name)
            for part in self._parts()
            for kind, name in REMEMBERING.items()
            if isinstance(part, kind)
        ]
        return [key for keys_of_one in lists for key in keys_of_one]

    def _asked(
        self, tensordict: TensorDictBase | None, set_state: bool | None, rows: Tensor | None
    ) -> TensorDictBase:
        given = super()._asked(tensordict, set_state, rows)
        if tensordict is None or set_state is False:
            return given
        memory = tensordict.select(*self._remembered(), strict=False)
        return given.copy().update(rows_of(memory, rows))

    def _input_td_has_state(self, tensordict: TensorDictBase | None) -> bool:
        # Not TransformedEnv's, which asks transforms for what they would begin at, and so draws.
        return EnvBase._input_td_has_state(self, tensordict)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return held(tensordict, super()._step(tensordict.exclude(STEP)))

    def _parts(self) -> list[Transform]:
        stack = self.transform
        return list(stack.transforms) if isinstance(stack, Compose) else [stack]


def resets_alone(transform: Transform) -> bool:
    """Whether a transform resets some environments of a batch without the others."""
    return isinstance(transform, StepCounter) or bool(getattr(transform, "resets_alone", False))


def _prepares(transform: Transform) -> bool:
    """Whether a transform says what an engine is to begin at."""
    own = type(transform)._reset_env_preprocess is not Transform._reset_env_preprocess
    return own or transform.enable_inv_on_reset
