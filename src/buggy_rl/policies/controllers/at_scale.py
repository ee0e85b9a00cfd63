"""A controller of the buggy for a similar car, and a driver that turns, reverses and brakes."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand, command_of, declared_by
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity, rotate
from buggy_rl.policies.controllers.room import Driver, RoomConfig, RoomDriver


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


PHASES = ("forward", "brake", "roll", "reverse")
FORWARD, BRAKE, ROLL, REVERSE = range(len(PHASES))
SECONDS = ((2.0, 5.0), (0.3, 1.2), (0.4, 1.5), (0.8, 2.2))  # [s] of each phase; chosen
FOLLOWING = (  # [-] chances of the next phase after each; chosen
    (0.0, 0.6, 0.25, 0.15),
    (0.2, 0.0, 0.3, 0.5),
    (0.5, 0.1, 0.0, 0.4),
    (0.6, 0.0, 0.4, 0.0),
)
BRAKES = (0.2, 1.0)  # [-] commands of a brake: a touch to an emergency
REVERSES = (0.3, 0.7)  # [-] commands of reverse
BACKWARD = (0.4, 1.3)  # [m/s] setpoints in reverse
CURRENT = (
    0.4  # [-] share of those commands where they are a motor force, without a brake of its own
)
FASTEST_BACK = 1.5  # [m/s] speed in reverse above which a person lets go; chosen
BEHIND = 1.2  # [m] looked behind the car for a wall


class ManoeuvringDriver(TensorDictModuleBase):
    """Drives any engine with brakes or reverse about a room.

    Args:
        config: The room.
        seed: Of what it decides.
        command: What its first command is; one-way speed setpoints are braked, but not reversed.
        full_speed: Setpoint of a full command [m/s], of a speed command.
        dt: Between two of its commands [s].
        forward: Who drives forward; by default the room driver, with this room, seed and dt.

    Raises:
        ValueError: The command is a one-way throttle, which has no brake.
    """

    def __init__(
        self,
        config: RoomConfig | None = None,
        seed: int = 0,
        command: LongitudinalCommand | None = None,
        full_speed: float = 5.0,
        dt: float = CONTROL_PERIOD,
        forward: RoomDriver | None = None,
    ) -> None:
        super().__init__()
        self.command = command or LongitudinalCommand("throttle_brake_reverse")
        if self.command.kind == "throttle":
            raise ValueError("driver=manoeuvring: a one-way throttle has no brake: driver=room")
        self.in_keys, self.out_keys = [keys.POSE, keys.VELOCITY], [keys.ACTION]
        self.room, self.full_speed = forward or RoomDriver(config, seed, dt), full_speed
        self.dt = dt
        self._generator = torch.Generator().manual_seed(seed + 1)
        self._phase = self._left = self._size = torch.empty(0)

    def start_pose(self, batch_size: Sequence[int]) -> Tensor:
        """Poses [*batch, 3] in the inner half of the room, facing anywhere."""
        return self.room.start_pose(batch_size)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2] for `pose` [*, 3] and `velocity` [*, 3]."""
        tensordict = self.room(tensordict)
        throttle, steering = tensordict[keys.ACTION].unbind(-1)
        vx = tensordict[keys.VELOCITY][..., 0]
        self._renew(tensordict[keys.POSE].cpu(), vx.cpu())
        drive = self._drive(0.5 * (throttle + 1)).clamp(-1.0, 1.0)
        drive = torch.where(vx < -FASTEST_BACK, drive.clamp_min(0.0), drive)
        if not self.command.two_way:
            drive = drive.clamp_min(0.0)
        action = torch.stack([command_of(drive, self.command.rest), steering], -1)
        return tensordict.set(keys.ACTION, action)

    def _uniform(self, shape: torch.Size) -> Tensor:
        return torch.rand(shape, generator=self._generator)

    def _renew(self, pose: Tensor, vx: Tensor) -> None:
        """Draws the next phase of cars whose phase has ended, or that near a wall backward."""
        shape = pose.shape[:-1]
        if self._phase.shape != shape:
            self._phase = torch.zeros(shape, dtype=torch.int64)
            self._left, self._size = 1.0 + self._uniform(shape), self._uniform(shape)
        self._left = self._left - self.dt
        backing = (self._phase == REVERSE) | ((self._phase == BRAKE) & (vx < 0))
        ended = (self._left <= 0) | (backing & ~self._room_behind(pose))
        if not ended.any():
            return
        chances = torch.tensor(FOLLOWING).cumsum(-1)[self._phase]
        phase = (self._uniform(shape).unsqueeze(-1) > chances).sum(-1).clamp_max(len(PHASES) - 1)
        low, high = torch.tensor(SECONDS)[phase].unbind(-1)
        seconds, size = low + (high - low) * self._uniform(shape), self._uniform(shape)
        self._phase = torch.where(ended, phase, self._phase)
        self._left = torch.where(ended, seconds, self._left)
        self._size = torch.where(ended, size, self._size)

    def _room_behind(self, pose: Tensor) -> Tensor:
        """Whether there is room [*] to back up."""
        back = torch.tensor([-BEHIND, 0.0]).expand_as(pose[..., :2])
        point = pose[..., :2] + rotate(back, pose[..., 2])
        config = self.room.config
        return point.abs().amax(-1) < config.size / 2 - config.clearance

    def _drive(self, forward: Tensor) -> Tensor:
        """Drive [*] in -1..1 of the phase; `forward` [*] in 0..1 is the room driver's."""
        if self.command.kind == "speed":
            return self._setpoint(forward) / self.full_speed
        share = CURRENT if self.command.kind == "current" else 1.0
        brake, reverse = (
            share * (low + (high - low) * self._size) for low, high in (BRAKES, REVERSES)
        )
        none = torch.zeros_like(forward)
        by_phase = torch.stack([forward, -brake, none, -reverse])
        return by_phase.gather(0, self._phase.unsqueeze(0)).squeeze(0)

    def _setpoint(self, forward: Tensor) -> Tensor:
        """Setpoint [*] [m/s]: the speed that the room driver's drive would hold."""
        room = self.room.config
        speed = ((forward - room.drive_at_rest) / room.drive_per_speed).clamp(0.0, 3.6)
        low, high = BACKWARD
        slower = 0.4 * self._size * speed
        by_phase = torch.stack(
            [speed, slower, torch.zeros_like(speed), -(low + (high - low) * self._size)]
        )
        return by_phase.gather(0, self._phase.unsqueeze(0)).squeeze(0)
