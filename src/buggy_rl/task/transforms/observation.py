"""The observation of the policy, one row of numbers."""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from buggy_rl import keys
from buggy_rl.task.transforms.base import TaskTransform, batched, measured_velocity, numbers


class Observation(TaskTransform):
    """o = (vx, vy, yaw_rate, x_1, y_1, ..., x_10, y_10): the original study's 23 numbers.

    Args:
        inputs: Keys in this order, each flattened; `velocity` is the measured one.
    """

    def __init__(self, inputs: Sequence[str] = (keys.VELOCITY, keys.WAYPOINTS)) -> None:
        super().__init__()
        self.inputs = tuple(inputs)
        if not self.inputs:
            raise ValueError("observation: inputs is empty: name at least one key")

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        batch = next_tensordict.batch_dims
        rows = [self._value(next_tensordict, key).flatten(batch) for key in self.inputs]
        return next_tensordict.set(keys.OBSERVATION, torch.cat(rows, -1))

    def _value(self, td: TensorDictBase, key: str) -> Tensor:
        return measured_velocity(td) if key == keys.VELOCITY else td.get(key)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        written = set(map(str, observation_spec.keys()))
        missing = [key for key in self.inputs if key not in written]
        if missing:
            raise ValueError(
                f"observation: nothing before it writes {', '.join(missing)}; "
                f"available: {', '.join(sorted(written))}"
            )
        batch = observation_spec.shape
        sizes = [observation_spec[key].shape[len(batch) :].numel() for key in self.inputs]
        observation_spec[keys.OBSERVATION] = batched(numbers(sum(sizes)), observation_spec)
        return observation_spec
