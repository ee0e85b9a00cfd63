"""What the environments for Gymnasium share: spaces, options of a reset, seeds, ends, infos."""

import operator
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Space
from gymnasium.utils import seeding
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import StepCounter

from buggy_rl.core import keys
from buggy_rl.core.option_values import nearest
from buggy_rl.task.env import TaskEnv
from buggy_rl.task.transforms.commands import ActionSmoothing, LastAction, RateLimit
from buggy_rl.task.transforms.observation import ClipVelocity, History, Observation
from buggy_rl.task.transforms.rewards import LeavePath, PathEnd, Rewards
from buggy_rl.task.transforms.waypoints import TargetSpeed, Waypoints

TOLD = (keys.PATH, keys.WAYPOINTS_CLOSED, keys.LATERAL_ERROR, keys.HEADING_ERROR, keys.COMPLETED)
"""Keys of an info with one number; `pose` and `velocity` have three."""
COMMANDS = (LastAction, ActionSmoothing, RateLimit)
PRESERVING = (*COMMANDS, Waypoints, TargetSpeed, Observation, History, LeavePath, PathEnd, Rewards)
"""Transforms that leave the measured velocity as it is, and what a policy sees of it."""


class Seeded:
    """Seeds for the environment underneath, from Gymnasium's generator of this one.

    Until a seed is given each reset takes its own from the operating system: what was copied by a
    fork would otherwise repeat the same paths in every process.
    """

    _np_random: np.random.Generator | None
    _np_random_seed: int | None
    _seeded = False

    def _drawn_seed(self, seed: int | None) -> int:
        self._seeded = self._seeded or seed is not None
        users_own = self._np_random_seed == -1  # by Gymnasium's convention
        if self._np_random is None or not (self._seeded or users_own):
            self._np_random, self._np_random_seed = seeding.np_random()
        return int(self._np_random.integers(2**63 - 1))


def refuse_keywords(unknown: Iterable[str], known: Iterable[str], name: str) -> None:
    """Refuses keywords that an environment does not have.

    Raises:
        TypeError: There is one; the message lists the known ones.
    """
    for keyword in unknown:
        raise TypeError(
            f"{name} got an unexpected keyword argument {keyword!r}; "  # TorchRL reads these words
            f"{nearest(keyword, known)}available: {', '.join(known)}"
        )


def start_of(options: Mapping[str, Any] | None, env: TaskEnv) -> TensorDictBase | None:
    """What a reset begins with, by its options; None leaves all to the task.

    Args:
        options: `path` is the index of a path, or one for each car of a batch.
        env: The environment underneath.

    Raises:
        ValueError: An option is unknown, or there is no such path.
    """
    waypoints = [part for part in env.transform if isinstance(part, Waypoints)]
    known = [keys.PATH] if waypoints else []
    for name in options or {}:
        if name not in known:
            raise ValueError(
                f"reset has no option {name!r}; {nearest(str(name), known)}"
                f"available: {', '.join(known) or 'none'}"
            )
    if not options:
        return None
    path = _indices(options[keys.PATH], len(waypoints[0].paths), env.batch_size)
    return TensorDict({keys.PATH: path}, env.batch_size).to(env.device)


def _indices(given: Any, count: int, batch: torch.Size) -> Tensor:
    """Indices [*batch, 1] of paths, of one for all or one for each."""
    chosen = np.asarray(given)
    if chosen.dtype.kind not in "iu" or chosen.shape not in ((), tuple(batch)):
        each = f", or an array of {batch.numel()} of them" if batch else ""
        raise ValueError(f"reset: path is {given!r}: must be an integer{each}")
    for index in map(operator.index, chosen.flat):
        if not 0 <= index < count:
            raise ValueError(
                f"reset: path is {index}: the task has {count} paths, from 0 to {count - 1}"
            )
    return torch.from_numpy(chosen.astype(np.int64)).expand(batch).unsqueeze(-1).clone()


def observation_space(env: TaskEnv) -> Space[NDArray[np.float32]]:
    """The space of one car's observation; velocities have the bounds of the task's clip.

    The way to a waypoint has no bound: a car may drive on after it has left its path.
    """
    shape = env.observation_spec[keys.OBSERVATION].shape[len(env.batch_size) :]
    low, high = np.full(shape, -np.inf, np.float32), np.full(shape, np.inf, np.float32)
    clip, shown = _clip(env), [p for p in env.transform if isinstance(p, Observation)]
    if clip is not None and shown:
        columns = _columns(env, shown[0])
        low[columns] = np.tile(clip.low.cpu().numpy(), len(columns) // 3)
        high[columns] = np.tile(clip.high.cpu().numpy(), len(columns) // 3)
    return Box(low, high, dtype=np.float32)


def _clip(env: TaskEnv) -> ClipVelocity | None:
    """The clip of the measured velocity, if nothing behind it can change what it bounds."""
    found = None
    for part in env.transform:
        if isinstance(part, ClipVelocity):
            found = part
        elif type(part) not in (*PRESERVING, StepCounter):
            found = None
    return found


def _columns(env: TaskEnv, shown: Observation) -> list[int]:
    """Columns of an observation that hold the measured velocity, of all rows of a history."""
    spec, batch = env.observation_spec, len(env.batch_size)
    sizes = [spec[key].shape[batch:].numel() for key in shown.inputs]
    starts = np.cumsum([0, *sizes])
    row = [
        int(start) + axis
        for key, start in zip(shown.inputs, starts, strict=False)
        if key in (keys.VELOCITY, keys.MEASURED_VELOCITY)
        for axis in range(3)
    ]
    whole, width = spec[keys.OBSERVATION].shape[-1], int(starts[-1])
    return [begin + column for begin in range(0, whole, width) for column in row]


def ends(after: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Which cars [*, 1] a step terminated, and which it truncated.

    `done` alone is a termination, as it is for TorchRL: a simulator may say no more than that.
    """
    done = after.get(keys.DONE)
    none = torch.zeros_like(done)
    truncated = after.get(keys.TRUNCATED, none)
    return after.get(keys.TERMINATED, none) | (done & ~truncated), truncated


def array(state: TensorDictBase, key: str) -> NDArray[Any]:
    """Content of a key as an array of its own, which no later step writes to."""
    return np.array(state.get(key).detach().cpu().numpy())
