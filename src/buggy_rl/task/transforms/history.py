"""The last observations side by side, for a policy that needs rates of change."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from buggy_rl import keys
from buggy_rl.task.transforms.base import TaskTransform, batched, numbers


class History(TaskTransform):
    """o'_t = (o_{t-rows+1}, ..., o_t), oldest first; after a reset all are the first one.

    The same numbers as TorchRL's `CatFrames(rows, dim=-1)`, which keeps them in the transform;
    here they ride in the TensorDict, so that a step is a function of it and a resumed run goes on
    as it was.

    Args:
        rows: Observations, the present one included.
    """

    reads: tuple[str, ...] = (keys.OBSERVATION,)

    def __init__(self, rows: int = 4) -> None:
        super().__init__()
        if rows < 1:
            raise ValueError(f"history: rows is {rows}: must be at least 1")
        self.rows = rows

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        row = tensordict_reset.get(keys.OBSERVATION).unsqueeze(-2)
        return self._write(tensordict_reset, row.repeat_interleave(self.rows, -2))

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        row = next_tensordict.get(keys.OBSERVATION).unsqueeze(-2)
        rows = tensordict.get(keys.OBSERVATION_ROWS)
        return self._write(next_tensordict, torch.cat([rows[..., 1:, :], row], -2))

    def _write(self, td: TensorDictBase, rows: Tensor) -> TensorDictBase:
        td.set(keys.OBSERVATION_ROWS, rows)
        return td.set(keys.OBSERVATION, rows.flatten(-2))

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        self._check_place(observation_spec, [keys.OBSERVATION_ROWS])
        size = observation_spec[keys.OBSERVATION].shape[-1]
        rows, flat = numbers(self.rows, size), numbers(self.rows * size)
        observation_spec[keys.OBSERVATION_ROWS] = batched(rows, observation_spec)
        observation_spec[keys.OBSERVATION] = batched(flat, observation_spec)
        return observation_spec
