"""Termination where a car leaves its path."""

from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.task.transforms.base import TaskTransform


class LeavePath(TaskTransform):
    """terminated if |lateral_error| > limit.

    The distance is from the piece of path before the next waypoint, so that a car which drove
    past a waypoint too far beside it leaves the path as it drives on.

    Args:
        limit: [m]
    """

    reads: tuple[str, ...] = (keys.LATERAL_ERROR,)
    before: tuple[str, ...] = (keys.REWARD_TERMS, keys.STEP_COUNT)

    def __init__(self, limit: float = 1.0) -> None:
        super().__init__()
        if not limit > 0:
            raise ValueError(f"leave_path: limit is {limit} m: must be above 0")
        self.limit = limit

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        left = next_tensordict.get(keys.LATERAL_ERROR).abs() > self.limit
        for key in (keys.TERMINATED, keys.DONE):
            next_tensordict.set(key, next_tensordict.get(key) | left)
        return next_tensordict
