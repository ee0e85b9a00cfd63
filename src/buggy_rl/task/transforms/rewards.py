"""The reward, a weighted sum of terms by name, and how an episode ends."""

from collections.abc import Callable, Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite

from buggy_rl.core import keys
from buggy_rl.task.transforms.base import TaskTransform, unbounded_spec


def waypoints_closed(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """1 for each waypoint closed in the step: the original study's reward (5.1)."""
    return after.get(keys.WAYPOINTS_CLOSED)


def progress(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """Distance gained along the path [m]; less than nothing when driving back."""
    return after.get(keys.PATH_POSITION) - before.get(keys.PATH_POSITION)


def deviation(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """-|lateral_error| [m]."""
    return -after.get(keys.LATERAL_ERROR).abs()


def steering_effort(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """-(s_t - s_{t-1})^2, with s the steering command."""
    change = after.get(keys.LAST_ACTION)[..., 1:] - before.get(keys.LAST_ACTION)[..., 1:]
    return -change.square()


def speed_error(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """-|vx - target_speed| [m/s]."""
    return -(after.get(keys.VELOCITY)[..., :1] - after.get(keys.TARGET_SPEED)).abs()


def terminated(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """-1 in the step in which the car fails."""
    return -after.get(keys.TERMINATED).float()


def out_of_range(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """-1 in a step that a learned simulator was not trained for; nothing over other engines.

    Without it a policy finds what such a simulator gets wrong, and drives there.
    """
    flag = after.get(keys.OUT_OF_RANGE, None)
    return torch.zeros_like(after.get(keys.REWARD)) if flag is None else -flag.float()


def range_excess(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """-how far beyond its training range a learned simulator is asked, in widths of that range.

    `out_of_range` with a slope, for policies that follow the gradient of the reward.
    """
    return -after.get(keys.RANGE_EXCESS, torch.zeros_like(after.get(keys.REWARD)))


def command_excess(before: TensorDictBase, after: TensorDictBase) -> Tensor:
    """-(|u| - 1)^2 of commands beyond their limits, where the simulator feels no change of them."""
    return -(before.get(keys.ACTION).abs() - 1.0).clamp_min(0.0).square().sum(-1, keepdim=True)


Term = Callable[[TensorDictBase, TensorDictBase], Tensor]
TERMS: dict[str, tuple[Term, tuple[str, ...]]] = {  # and the keys that each reads
    "waypoints_closed": (waypoints_closed, (keys.WAYPOINTS_CLOSED,)),
    "progress": (progress, (keys.PATH_POSITION,)),
    "deviation": (deviation, (keys.LATERAL_ERROR,)),
    "steering_effort": (steering_effort, (keys.LAST_ACTION,)),
    "speed_error": (speed_error, (keys.TARGET_SPEED,)),
    "terminated": (terminated, ()),
    "out_of_range": (out_of_range, ()),
    "range_excess": (range_excess, ()),
    "command_excess": (command_excess, ()),
}


class Rewards(TaskTransform):
    """r = sum_i weight_i term_i; the weighted terms are kept in `reward_terms`.

    Args:
        weights: By the name of the term.
    """

    def __init__(self, weights: Mapping[str, float] | None = None) -> None:
        super().__init__()
        self.weights = dict({"waypoints_closed": 1.0} if weights is None else weights)
        unknown = sorted(set(self.weights) - set(TERMS))
        if unknown or not self.weights:
            raise ValueError(
                f"rewards: no term {', '.join(unknown) or 'at all'}; "
                f"available: {', '.join(sorted(TERMS))}"
            )
        self.reads = tuple(key for name in self.weights for key in TERMS[name][1])
        self.writes = {keys.REWARD_TERMS: unbounded_spec(len(self.weights))}

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        pose = tensordict_reset.get(keys.POSE)
        nothing = pose.new_zeros((*pose.shape[:-1], len(self.weights)))
        return tensordict_reset.set(keys.REWARD_TERMS, nothing)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        terms = [
            weight * TERMS[name][0](tensordict, next_tensordict)
            for name, weight in self.weights.items()
        ]
        row = torch.cat(terms, -1)  # (*, terms)
        next_tensordict.set(keys.REWARD_TERMS, row)
        return next_tensordict.set(keys.REWARD, row.sum(-1, keepdim=True))


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


class Endings(TaskTransform):
    """done = terminated or truncated, of what a simulator of one's own says of them.

    Nearest to the engine. An episode that is done for no reason counts as terminated.
    """

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        done, failed = (next_tensordict.get(key) for key in (keys.DONE, keys.TERMINATED))
        over = failed | next_tensordict.get(keys.TRUNCATED, torch.zeros_like(failed))
        next_tensordict.set(keys.TERMINATED, failed | (done & ~over))
        return next_tensordict.set(keys.DONE, done | over)


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
        truncated = next_tensordict.get(keys.TRUNCATED, None)  # by the simulator itself
        truncated = completed if truncated is None else truncated | completed
        next_tensordict.set(keys.TRUNCATED, truncated)
        return next_tensordict.set(keys.DONE, next_tensordict.get(keys.DONE) | completed)

    def transform_done_spec(self, done_spec: Composite) -> Composite:
        done_spec[keys.TRUNCATED] = done_spec[keys.DONE].clone()
        return done_spec
