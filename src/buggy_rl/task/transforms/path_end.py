"""Truncation at the end of an open path, which is no failure."""

import torch
from tensordict import TensorDictBase
from torchrl.data import Composite

from buggy_rl import keys
from buggy_rl.task.transforms.base import TaskTransform


class PathEnd(TaskTransform):
    """truncated if completed. Not terminated: the car could have gone on, the path could not."""

    reads: tuple[str, ...] = (keys.COMPLETED,)
    before: tuple[str, ...] = (keys.STEP_COUNT,)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        truncated = torch.zeros_like(tensordict_reset.get(keys.COMPLETED))
        return tensordict_reset.set(keys.TRUNCATED, truncated)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        completed = next_tensordict.get(keys.COMPLETED)
        next_tensordict.set(keys.TRUNCATED, completed)
        return next_tensordict.set(keys.DONE, next_tensordict.get(keys.DONE) | completed)

    def transform_done_spec(self, done_spec: Composite) -> Composite:
        done_spec[keys.TRUNCATED] = done_spec[keys.DONE].clone()
        return done_spec
