"""Tracks that a simulator drives: under the commands of a recording, or round a path."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.policies.closed_loop import Driver
from buggy_rl.recordings.recording import Recording
from buggy_rl.stepping import trajectory
from buggy_rl.task.transforms.waypoints import Waypoints
from buggy_rl.vehicle import CONTROL_PERIOD
from buggy_rl.viz.film.track import Course, Track, from_rollout, recording_rows

WARM_UP = (
    30  # rows (0.3 s) of imposed motion before a start, for latent states that no one measured
)


def replayed(
    make: Callable[[int], EnvBase],
    recording: Recording,
    name: str,
    start: float = 0.0,
    seconds: float = float("inf"),
    restart: float = 0.0,
) -> Track:
    """What a simulator makes of a recording's commands, from its measured pose and velocity.

    Args:
        make: Builds the simulator for a number of environments.
        recording: Commands, starts and length.
        name: In the legend.
        start: [s] of the recording.
        seconds: Length at most [s].
        restart: [s] after which it starts again from what was measured; 0 for never.

    Raises:
        ValueError: `start` is outside the recording or in a gap, or the simulator diverges.
    """
    rows = recording_rows(recording, start, seconds)
    count = rows.stop - rows.start
    horizon = min(count, max(1, round(restart / recording.dt)) if restart else count)
    begins = torch.arange(rows.start, rows.stop, horizon)  # (N,)
    # Row k of environment i is row begins[i] - WARM_UP + k of the recording, held at its ends.
    index = begins[:, None] + torch.arange(-WARM_UP, horizon)
    index = index.clamp(_segment_start(recording, rows.start), rows.stop - 1)  # (N, L)
    pose, velocity, action = (
        recording.data[key][index] for key in (keys.POSE, keys.VELOCITY, keys.ACTION)
    )

    def act(row: int, state: TensorDictBase) -> TensorDictBase:
        if row <= WARM_UP:
            state[keys.POSE] = pose[:, row].to(state[keys.POSE])
            state[keys.VELOCITY] = velocity[:, row].to(state[keys.VELOCITY])
        return state.set(keys.ACTION, action[:, row])

    env = make(len(begins))
    begin = TensorDict({keys.POSE: pose[:, 0], keys.VELOCITY: velocity[:, 0]}, [len(begins)])
    states = trajectory(env, env.reset(begin), act, index.shape[1])
    driven = _stacked(states)[:, WARM_UP:]  # (N, horizon)
    flat = cast(TensorDict, cast(TensorDict, driven).reshape(-1)[:count])
    again = recording.dt * torch.arange(horizon, count, horizon).double().numpy()
    return replace(from_rollout(flat, name, recording.dt), restarts=again)


def driven(env: EnvBase, driver: Driver, steps: int, name: str, seed: int = 0) -> Track:
    """What a driver makes of the first path of a task, to the end of its episode.

    Args:
        env: From `make_env`, with a batch of one car.
        driver: A policy's `driver()`, or one of `buggy_rl.policies.controllers`.
        steps: Longest episode.
        name: In the legend.
        seed: Of the start and of noise.
    """
    kept = []
    with torch.random.fork_rng():
        torch.manual_seed(seed)  # of what has no generator of its own
        env.set_seed(seed)
        states = trajectory(env, env.reset(), lambda _, now: driver(now), steps)
        for state, following in pairwise(states):
            kept.append(_shown(state))
            if bool(following[keys.DONE].any()):
                break
    rows = cast(TensorDict, cast(TensorDict, TensorDict.stack(kept, 1))[0])
    return from_rollout(rows, name, getattr(env, "dt", CONTROL_PERIOD), course_of(env))


def course_of(env: EnvBase, index: int = 0) -> Course | None:
    """The path of an environment's transforms; None where there is no path."""
    transform = getattr(env, "transform", None)
    for part in transform if transform is not None else ():
        if isinstance(part, Waypoints):
            paths = part.paths
            points = paths.points[index, : int(paths.count[index])].double().numpy()
            return Course(points, bool(paths.closed[index]))
    return None


def _stacked(states) -> TensorDictBase:
    """States with their actions [N, T]; the last one, which has none, is left out."""
    kept = [_shown(state) for state, _ in pairwise(states)]
    return cast(TensorDict, TensorDict.stack(kept, 1))


def _shown(state: TensorDictBase) -> TensorDictBase:
    """What a track needs of a state."""
    wanted = (keys.POSE, keys.VELOCITY, keys.ACTION, keys.NEXT_WAYPOINT)
    return state.select(*wanted, strict=False).clone()


def _segment_start(recording: Recording, row: int) -> int:
    """First row of the segment that a row is in."""
    segment: Tensor = recording.data[keys.SEGMENT].flatten()
    return int((segment == segment[row]).nonzero()[0])
