"""The mean of the last velocities: the filter that runs on the car."""

import torch
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.task.transforms.base import TaskTransform, measured_velocity, numbers


class PastMean(TaskTransform):
    """v'_t = (v_{t-width+1} + ... + v_t) / width; at the start the mean of what there is.

    The same as `recordings.filters.past_mean`, one row at a time. The memory has a fourth number
    beside each velocity, 1 where there is one, so that its sum counts them.

    Args:
        width: Rows, the present one included; the original study's 5.
    """

    before: tuple[str, ...] = (keys.OBSERVATION,)

    def __init__(self, width: int = 5) -> None:
        super().__init__()
        if width < 1:
            raise ValueError(f"past_mean: width is {width}: must be at least 1")
        self.width = width
        rows, mean = numbers(width, 4), numbers(3)
        self.writes = {keys.VELOCITY_ROWS: rows, keys.MEASURED_VELOCITY: mean}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        velocity = measured_velocity(tensordict_reset)
        rows = velocity.new_zeros((*velocity.shape[:-1], self.width, 4))
        return self._write(tensordict_reset, rows, velocity)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        rows = tensordict.get(keys.VELOCITY_ROWS)
        return self._write(next_tensordict, rows, measured_velocity(next_tensordict))

    def _write(self, td: TensorDictBase, rows: Tensor, velocity: Tensor) -> TensorDictBase:
        row = torch.cat([velocity, torch.ones_like(velocity[..., :1])], -1).unsqueeze(-2)
        rows = torch.cat([rows[..., 1:, :], row], -2)  # (*, width, 4)
        total = rows.sum(-2)
        td.set(keys.VELOCITY_ROWS, rows)
        return td.set(keys.MEASURED_VELOCITY, total[..., :3] / total[..., 3:])
