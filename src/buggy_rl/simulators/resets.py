"""Resets and steps of some environments of a batch, by TorchRL's `_reset`, `_step`, `set_state`.

Environments [*batch] are counted in the order of the flattened batch; `rows` [k] int64 are some of
them, None all.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys

RESET = "_reset"  # [1] bool, environments that are reset
STEP = "_step"  # [] bool, environments that move


class ResettableEnv(EnvBase):
    """An environment that begins at a state, and of whose batch some begin alone.

    With `set_state=True` it begins at what the TensorDict holds of its state; what is not there is
    estimated. With `set_state=False`, and by default where a `_reset` mask is given, it begins
    anew.
    """

    _supports_set_state = True

    @abstractmethod
    def _begin(self, given: TensorDictBase, rows: Tensor | None) -> TensorDictBase:
        """State [*batch], or [k] of `rows`, right after a reset; `given` is what it begins at."""

    def _resolve_set_state(
        self,
        set_state: bool | None,
        tensordict: TensorDictBase | None,
        select_reset_only: bool,
    ) -> bool | None:
        if set_state is None and tensordict is not None and tensordict.get(RESET, None) is not None:
            set_state = False  # what is there is where the environments ended
        return super()._resolve_set_state(set_state, tensordict, select_reset_only)

    def _asked(
        self, tensordict: TensorDictBase | None, set_state: bool | None, rows: Tensor | None
    ) -> TensorDictBase:
        """What a reset is to begin at: state found in the TensorDict, of `rows`."""
        if tensordict is None or set_state is False:
            shape = self.batch_size if rows is None else rows.shape
            return TensorDict(batch_size=shape, device=self.device)
        given = tensordict.select(*self.state_spec.keys(True, True), strict=False)
        return rows_of(given, rows)

    def reset(
        self,
        tensordict: TensorDictBase | None = None,
        *,
        set_state: bool | None = None,
        **kwargs: Any,
    ) -> TensorDictBase:
        """Resets as TorchRL does, but puts the rows that are reset into the batch as it is."""
        return super().reset(tensordict, set_state=set_state, alone=True, **kwargs)

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        set_state: bool | None = None,
        alone: bool = False,
        **_: Any,
    ) -> TensorDictBase:
        """State [*batch], or with `alone` [k] of the rows that are reset."""
        rows = masked_rows(tensordict)
        state = self._begin(self._asked(tensordict, set_state, rows), rows)
        return state if rows is None or alone else spread(state, rows, self.batch_size)

    def _reset_proc_data(
        self, tensordict: TensorDictBase | None, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = masked_rows(tensordict)
        if rows is None or tensordict is None:
            return super()._reset_proc_data(tensordict, tensordict_reset)  # type: ignore[misc]
        over = [key for key in self.done_keys if tensordict_reset.get(key).any()]
        if over:
            raise RuntimeError(f"{', '.join(map(str, over))} is true right after a reset")
        tensordict.pop(RESET)
        return put(tensordict, tensordict_reset, rows)


def masked_rows(tensordict: TensorDictBase | None) -> Tensor | None:
    """Environments that a reset is asked for; None where it is for all, or for none."""
    mask = None if tensordict is None else tensordict.get(RESET, None)
    if mask is None or tensordict is None:
        return None
    mask = mask.reshape(tensordict.numel(), -1).any(-1)
    rows = mask.nonzero().squeeze(-1)
    return None if len(rows) in (0, len(mask)) else rows


def rows_of(tensordict: TensorDictBase, rows: Tensor | None) -> TensorDictBase:
    """A TensorDict [k] of some rows, or the given one."""
    return tensordict if rows is None else tensordict.reshape(-1)[rows]


def spread(part: TensorDictBase, rows: Tensor, shape: Sequence[int]) -> TensorDictBase:
    """A TensorDict of a batch's shape with `part` [k] in its rows, and zeros in the others."""
    count = torch.Size(shape).numel()

    def placed(value: Tensor) -> Tensor:
        whole = value.new_zeros((count, *value.shape[1:]))
        return whole.index_copy_(0, rows, value).reshape(*shape, *value.shape[1:])

    return part.apply(placed, batch_size=torch.Size(shape))  # type: ignore[return-value]


def put(whole: TensorDictBase, part: TensorDictBase, rows: Tensor) -> TensorDictBase:
    """Writes `part` [k] into rows of a TensorDict, whose tensors stay; it is returned.

    A key that only one of the two has is 0 in the rows, or in the others, as TorchRL has it.
    """
    batch, count = len(whole.batch_size), whole.numel()
    known = dict(part.items(True, True))
    for key, value in list(whole.items(True, True)):
        # Not -1: a history may have no rows, and then no size could be told from it.
        flat, new = value.reshape(count, *value.shape[batch:]), known.pop(key, None)
        flat = flat.index_fill(0, rows, 0) if new is None else flat.index_copy(0, rows, new)
        whole.set(key, flat.reshape(value.shape))
    for key, new in known.items():
        whole.set(key, spread(TensorDict({"new": new}, rows.shape), rows, whole.batch_size)["new"])
    return whole


def begun(env: EnvBase, given: TensorDictBase, rows: Tensor | None) -> TensorDictBase:
    """State right after a reset of some environments of any simulator; `given` is of them alone.

    A simulator that knows no `set_state` begins at a pose and velocity that it is given; the rest
    of its state is set here.
    """
    if isinstance(env, ResettableEnv):
        return env._begin(given, rows)
    latent = [k for k in env.state_spec.keys(True, True) if k not in (keys.POSE, keys.VELOCITY)]
    given = given.select(keys.POSE, keys.VELOCITY, *latent, strict=False)
    whole = given if rows is None else spread(given, rows, env.batch_size)
    told = None if rows is None and given.is_empty() else whole.copy()
    if told is not None and rows is not None:
        flag = torch.ones(len(rows), 1, dtype=torch.bool, device=rows.device)
        told.update(spread(TensorDict({RESET: flag}, rows.shape), rows, env.batch_size))
    options = {"set_state": not given.is_empty()} if env._supports_set_state else {}
    state = env._reset(told, **options)  # type: ignore[arg-type]
    env._complete_done(env.full_done_spec_unbatched, state)
    return rows_of(state, rows).update(given.select(*latent, strict=False).clone())


def held(before: TensorDictBase, after: TensorDictBase) -> TensorDictBase:
    """What follows a state by its `_step` mask, if it has one: environments stand still elsewhere.

    Args:
        before: State of a step, with the mask [*batch].
        after: What follows where all move; changed in place.
    """
    moving = before.get(STEP, None)
    if moving is None:
        return after
    moving = moving.reshape(after.batch_size)
    for key, value in list(after.items(True, True)):
        last = None if key == keys.REWARD else before.get(key, None)
        last = torch.zeros_like(value) if last is None else last
        mask = moving.reshape(moving.shape + (1,) * (value.dim() - moving.dim()))
        after.set(key, torch.where(mask, value, last))
    return after
