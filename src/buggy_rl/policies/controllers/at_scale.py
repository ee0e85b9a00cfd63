"""A controller of the buggy that drives a similar car of another size."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.car_file import load_car
from buggy_rl.longitudinal import ONE_WAY, LongitudinalCommand, declared_by
from buggy_rl.policies.controllers.recording import Driver
from buggy_rl.similarity import Similarity


class AtScale(TensorDictModuleBase):
    """Shows a controller the waypoints and velocities of the similar buggy; commands are the same.

    x' = x / L,  v' = v / S,  r' = r L / S, with the ratios L of lengths and S of speeds: a
    controller's distances, speeds and gains stay those of the buggy. Its times scale with L / S.

    Args:
        controller: That reads `waypoints` and `velocity`, and writes `action`.
        scale: Ratios of the car to the buggy.
    """

    def __init__(self, controller: TensorDictModuleBase, scale: Similarity) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [keys.WAYPOINTS, keys.VELOCITY], [keys.ACTION]
        self.controller, self.scale = controller, scale

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2] for `waypoints` [*, W, 2] and `velocity` [*, 3]."""
        seen = tensordict.select(keys.WAYPOINTS, keys.VELOCITY)
        seen[keys.WAYPOINTS] = tensordict[keys.WAYPOINTS] / self.scale.length
        seen[keys.VELOCITY] = _reduced(tensordict[keys.VELOCITY], self.scale)
        tensordict[keys.ACTION] = self.controller(seen)[keys.ACTION]
        return tensordict


class RoomAtScale(TensorDictModuleBase):
    """Shows a driver about a room the pose and velocity of the similar buggy.

    The room is L times as large, and the driver's own times as long, if it is built with
    dt' = dt S / L, the time that passes for the buggy between two commands.

    Args:
        driver: That reads `pose` and `velocity`, and writes `action`.
        scale: Ratios of the car to the buggy.
    """

    def __init__(self, driver: Driver, scale: Similarity) -> None:
        super().__init__()
        self.in_keys, self.out_keys = [keys.POSE, keys.VELOCITY], [keys.ACTION]
        self.driver, self.scale = driver, scale

    def start_pose(self, batch_size: Sequence[int]) -> Tensor:
        """Poses [*batch, 3] in the inner half of the room, facing anywhere."""
        return self.driver.start_pose(batch_size) * self._lengths()

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2] for `pose` [*, 3] and `velocity` [*, 3]."""
        seen = tensordict.select(keys.POSE, keys.VELOCITY)
        seen[keys.POSE] = tensordict[keys.POSE] / self._lengths().to(tensordict[keys.POSE])
        seen[keys.VELOCITY] = _reduced(tensordict[keys.VELOCITY], self.scale)
        tensordict[keys.ACTION] = self.driver(seen)[keys.ACTION]
        return tensordict

    def _lengths(self) -> Tensor:
        return torch.tensor([self.scale.length, self.scale.length, 1.0])


def _reduced(velocity: Tensor, scale: Similarity) -> Tensor:
    """Velocity [*, 3] of the similar buggy."""
    units = [scale.of(unit) for unit in ("m/s", "m/s", "rad/s")]
    return velocity / torch.tensor(units, device=velocity.device)


Follower = Callable[[LongitudinalCommand], TensorDictModuleBase]
"""Builds a controller of the buggy that gives a kind of first command."""


def for_car(
    make: Follower, car: str, command: LongitudinalCommand | None = None
) -> TensorDictModuleBase:
    """A controller for a car by name or file; an empty name is the buggy.

    Args:
        make: Builds it.
        car: Name or file.
        command: What the first command is; by default what the car's file says.
    """
    if not car:
        return make(command or ONE_WAY)
    file = load_car(car)
    command = command or file.command
    if command.full_speed is not None:  # of the similar buggy
        command = replace(command, full_speed=command.full_speed / file.similarity.speed)
    return AtScale(make(command), file.similarity)


def taken_by(engine: Any) -> LongitudinalCommand:
    """What an engine's first command is, with the setpoint of a full speed command."""
    command, values = declared_by(engine), getattr(engine, "values", {})
    if command.kind != "speed" or "full_speed" not in values:
        return command
    return replace(command, full_speed=float(values["full_speed"].mean()))
