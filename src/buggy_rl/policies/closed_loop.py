"""Closed-loop evaluation: one episode on each path, scored from what the task reports."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import pairwise

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.stepping import trajectory
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.task.transforms.waypoints import Waypoints


class TrackReset:
    """Puts a car at rest on the waypoint that it closed last, along the path, and holds it there.

    A car is reset when the task says that it has failed (`terminated`), and when it has closed no
    waypoint for `patience` seconds, because it stands or has spun. Its latent state, such as an
    emptying battery, goes on.

    Args:
        env: From `make_env`, with a batch of N cars.
        patience: Longest time without a waypoint [s].
        handling: Time for which a car is held [s].

    Raises:
        ValueError: The task has no waypoints.
    """

    def __init__(self, env: EnvBase, patience: float = 2.0, handling: float = 2.0) -> None:
        found = [part for part in env.modules() if isinstance(part, Waypoints)]
        if not found:
            raise ValueError("a track reset needs a task with waypoints to put cars back on")
        self.waypoints = found[0]
        self.patience = round(patience / CONTROL_PERIOD)
        self.handling = round(handling / CONTROL_PERIOD)
        self.idle, self.held, self.times = torch.zeros(
            3, env.batch_size.numel(), 1, device=env.device
        ).unbind(0)

    def __call__(self, following: TensorDictBase) -> Tensor:
        """Moves the cars that are to be reset, in the TensorDict that a step led to.

        Returns:
            Which cars are held [N, 1]; `times` counts how often each was reset.
        """
        self.idle = torch.where(following[keys.WAYPOINTS_CLOSED] > 0, 0.0, self.idle + 1)
        lost = following[keys.TERMINATED] | (self.idle >= self.patience)
        taken = lost & (self.held == 0) & ~following[keys.COMPLETED]
        self.times = self.times + taken
        self.held = torch.where(taken, float(self.handling), (self.held - 1).clamp_min(0.0))
        held = self.held > 0
        self.idle = self.idle * ~held
        there, moving = self.waypoints.last_closed(following), following[keys.VELOCITY]
        following[keys.POSE] = torch.where(held, there, following[keys.POSE])
        following[keys.VELOCITY] = torch.where(held, torch.zeros_like(moving), moving)
        return held


Driver = Callable[[TensorDictBase], TensorDictBase]
"""Writes `action` into the TensorDict it is given, and returns it."""


@dataclass(frozen=True)
class Scores:
    """Scores of each episode; all [N], on the device of the environment."""

    waypoints: Tensor
    """Waypoints closed."""
    kept_on: Tensor
    """Share of the steps before the car left the path or, with a track reset, for which it was not
    held; 1 also when the path was completed."""
    lateral_mean: Tensor
    """Mean distance from the path [m]."""
    lateral_rms: Tensor
    """Root mean square of it [m]."""
    lateral_max: Tensor
    """Largest distance from the path [m]."""
    heading_mean: Tensor
    """Mean absolute heading error [rad]."""
    spun: Tensor
    """1 where the car turned by more than 90 degrees from its path, else 0."""
    speed: Tensor
    """Mean vx [m/s]."""
    steering_effort: Tensor
    """Mean absolute change of the steering command a step."""
    out_of_range: Tensor
    """Share of steps outside what a learned simulator was trained on; nan over other engines."""

    def chunk(self, parts: int) -> list["Scores"]:
        """The episodes in as many parts, in their order."""
        columns = {f.name: getattr(self, f.name).chunk(parts) for f in fields(self)}
        return [Scores(**{n: column[i] for n, column in columns.items()}) for i in range(parts)]

    def means(self) -> dict[str, float]:
        """Mean over the episodes, by name."""
        return {f.name: getattr(self, f.name).mean().item() for f in fields(self)}


@torch.no_grad()
def drive(
    env: EnvBase, driver: Driver, steps: int, track_reset: TrackReset | None = None
) -> Scores:
    """Scores one episode of each environment; steps after its end do not count.

    With a track reset the episode does not end where the car leaves its path: the car is put back,
    and the steps for which it is held do not count.

    Args:
        env: From `make_env`, with a batch of N cars and `order: fixed` for one path each.
        driver: A policy's `driver()`, or one of `buggy_rl.policies.controllers`.
        steps: Of an episode.
        track_reset: Of the same env, for this episode alone.
    """
    nothing = torch.zeros(env.batch_size.numel(), 1, device=env.device)
    alive = going = nothing + 1.0
    sums = {name: nothing.clone() for name in SUMMED}
    furthest = turned = driven = nothing
    completed = nothing > 0
    flagged: Tensor | None = None
    states = trajectory(env, env.reset(), lambda _, state: driver(state), steps)
    for state, following in pairwise(states):
        for name, value in _terms(following, state[keys.LAST_ACTION]).items():
            sums[name] += alive * value
        furthest = torch.maximum(furthest, alive * following[keys.LATERAL_ERROR].abs())
        turned = torch.maximum(turned, alive * following[keys.HEADING_ERROR].abs())
        if keys.OUT_OF_RANGE in following:
            flagged = nothing if flagged is None else flagged
            flagged = flagged + alive * following[keys.OUT_OF_RANGE]
        driven = driven + alive
        completed = completed | (alive > 0) & following[keys.COMPLETED]
        going = going * ~following[keys.DONE if track_reset is None else keys.COMPLETED]
        alive = going if track_reset is None else going * ~track_reset(following)
        if not going.any():
            break
    mean = {name: (total / driven).squeeze(-1) for name, total in sums.items()}
    unknown = torch.full_like(driven, float("nan"))
    return Scores(
        waypoints=sums["waypoints"].squeeze(-1),
        kept_on=torch.where(completed, 1.0, driven / steps).squeeze(-1),
        lateral_mean=mean["lateral"],
        lateral_rms=mean["lateral_square"].sqrt(),
        lateral_max=furthest.squeeze(-1),
        heading_mean=mean["heading"],
        spun=(turned > math.pi / 2).float().squeeze(-1),
        speed=mean["speed"],
        steering_effort=mean["effort"],
        out_of_range=(unknown if flagged is None else flagged / driven).squeeze(-1),
    )


SUMMED = ("waypoints", "lateral", "lateral_square", "heading", "speed", "effort")


def _terms(following: TensorDictBase, before: Tensor) -> dict[str, Tensor]:
    """What a step adds to the sums, [N, 1] each; `before` [N, 2] is the action before it."""
    lateral = following[keys.LATERAL_ERROR]
    return {
        "waypoints": following[keys.WAYPOINTS_CLOSED],
        "lateral": lateral.abs(),
        "lateral_square": lateral.square(),
        "heading": following[keys.HEADING_ERROR].abs(),
        "speed": following[keys.VELOCITY][..., :1],
        "effort": (following[keys.LAST_ACTION] - before)[..., 1:].abs(),
    }
