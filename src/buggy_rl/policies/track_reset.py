"""Resets a car that left its path to its last waypoint, as a person beside the track does."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.task.transforms.waypoints import Waypoints
from buggy_rl.vehicle import CONTROL_PERIOD


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
