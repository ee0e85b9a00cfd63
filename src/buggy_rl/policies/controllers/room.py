"""The room driver: gathers data as a person does who drives about an empty room.

It runs two programmes side by side, one for the steering and one for the throttle, each drawn anew
when it ends, and leaves both to turn away from the walls while its car can still do so.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD, rotate


class Driver(Protocol):
    """Who drives about the room."""

    def start_pose(self, batch_size: Sequence[int]) -> Tensor:
        """Poses at which its cars start, [*batch, 3]."""
        ...

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action`."""
        ...


@dataclass(frozen=True)
class RoomConfig:
    """The room and what the driver believes of the car; cautious, so that any engine stays in."""

    size: float = 8.0
    """Side of the square room, centred on the world's origin [m]."""
    clearance: float = 0.3
    """Kept between the tracking sensor and a wall [m]."""
    turning_radius: float = 0.75
    """Radius of a slow turn at 80 % of the lock [m]."""
    lateral_acceleration: float = 5.5
    """Lateral acceleration that a fast turn reaches [m/s^2]."""
    reaction: float = 0.2
    """Time from seeing to the car's answer [s]."""
    drive_at_rest: float = 0.22
    """Drive in 0..1 that just moves the car."""
    drive_per_speed: float = 0.1
    """Further drive for each m/s to be held [s/m]."""
    thumb_rate: float = 25.0
    """Fastest change of a command [1/s]."""


STEERING_KINDS = ("hold", "ramp", "sweep", "steps", "straight")
STEERING_CHANCES = (0.2, 0.2, 0.25, 0.15, 0.2)
THROTTLE_KINDS = ("coast", "stop", "hold_speed", "constant", "burst", "ramp", "pulses")
THROTTLE_CHANCES = (0.12, 0.07, 0.21, 0.16, 0.16, 0.16, 0.12)
THROTTLE_SECONDS = ((0.4, 1.5), (3.0, 6.0), (1, 4), (1, 3), (0.25, 0.8), (1, 3), (1.5, 3))
STOP = THROTTLE_KINDS.index("stop")
STANDING_SPEED = 0.03  # [m/s] below it a stop is complete ...
STANDING_SECONDS = 0.8  # [s] ... and lasts no longer than this
SPEEDS = ((0.4, 1.2), (1.2, 2.2), (2.2, 3.6))  # [m/s] slow, medium and fast driving
SPEED_CHANCES = (0.25, 0.3, 0.45)
CROSSING_CHANCE = 0.5
SLOW = 0.5  # [m/s] below it a drift angle means nothing
CREEPING_SPEED = 0.8  # [m/s] to get away from a wall that is too close to drive off freely
TURNING_SPEED = 2.6  # [m/s] that is not exceeded while turning away from a wall
CLEAR_ROOM = 0.3  # [m] between a turn that fits and the wall, to be free again
LARGEST_DRIFT = 0.35  # [rad] of the car against its course; beyond it a person lifts off
STEERED_DRIVE = 0.5  # drive in 0..1 a person dares at full lock
STRAIGHT_AMPLITUDE = 0.1  # command of what a person would call going straight
FULL_THROTTLE_GAIN = 1.0  # [m/s] what a car may still gain while the driver reacts


class RoomDriver(TensorDictModuleBase):
    """Drives any engine about a room; `env.rollout(steps, policy=driver)`.

    All it remembers is in `memory`, a dictionary of tensors of the batch's shape.

    Args:
        config: The room.
        seed: Of what it decides; the global random state is neither read nor changed.
        dt: Between two of its commands [s].
    """

    def __init__(
        self, config: RoomConfig | None = None, seed: int = 0, dt: float = CONTROL_PERIOD
    ) -> None:
        super().__init__()
        self.in_keys = [keys.POSE, keys.VELOCITY]
        self.out_keys = [keys.ACTION]
        self.config = config or RoomConfig()
        self.dt = dt
        self.memory: dict[str, Tensor] = {}
        self._generator = torch.Generator().manual_seed(seed)

    def start_pose(self, batch_size: Sequence[int]) -> Tensor:
        """Poses [*batch, 3] in the inner half of the room, facing anywhere."""
        spread = torch.rand(*batch_size, 3, generator=self._generator) - 0.5
        return spread * torch.tensor([self.config.size / 2, self.config.size / 2, 2 * math.pi])

    def reset(self, batch_size: Sequence[int]) -> None:
        """Forgets; every car then stands a moment before it moves off."""
        shape = torch.Size(batch_size)
        names = (
            "steering_left", "steering_kind", "steering_from", "amplitude", "slow", "fast",
            "throttle_left", "throttle_kind", "speed", "period", "side", "throttle", "steering",
        )  # fmt: skip
        self.memory = {name: torch.zeros(shape) for name in names}
        self.memory["steering_seconds"] = torch.ones(shape)
        self.memory["throttle_seconds"] = torch.ones(shape)
        self.memory["throttle_left"] = self._uniform(shape, 0.3, 1.0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes `action` [*, 2] for `pose` [*, 3] and `velocity` [*, 3]."""
        pose, velocity = tensordict[keys.POSE].cpu(), tensordict[keys.VELOCITY].cpu()
        if not self.memory or self.memory["side"].shape != pose.shape[:-1]:
            self.reset(pose.shape[:-1])
        speed = torch.linalg.vector_norm(velocity[..., :2], dim=-1)
        self._draw_steering()
        self._draw_throttle(speed)
        steering = self._steering()
        drive = self._kept_straight(velocity, self._drive(speed), steering)
        drive, steering = self._kept_inside(pose, velocity, speed, drive, steering)
        action = self._thumbed(2.0 * drive.clamp(0.0, 1.0) - 1.0, steering.clamp(-1.0, 1.0))
        tensordict[keys.ACTION] = action.to(tensordict[keys.POSE])
        return tensordict

    def _uniform(self, shape: Sequence[int], low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(torch.Size(shape), generator=self._generator)

    def _chosen(self, shape: Sequence[int], chances: Sequence[float]) -> Tensor:
        bounds = torch.tensor(chances).cumsum(0)[:-1]
        return torch.bucketize(torch.rand(torch.Size(shape), generator=self._generator), bounds)

    def _renew(self, mask: Tensor, **drawn: Tensor) -> None:
        for name, value in drawn.items():
            self.memory[name] = torch.where(mask, value.float(), self.memory[name])

    def _draw_steering(self) -> None:
        ended, shape = self.memory["steering_left"] <= 0, self.memory["side"].shape
        self.memory["steering_left"] = self.memory["steering_left"] - self.dt
        if not ended.any():
            return
        sign = torch.sign(self._uniform(shape, -1, 1))
        seconds = self._uniform(shape, 0.5, 3.0)
        self._renew(
            ended,
            steering_kind=self._chosen(shape, STEERING_CHANCES),
            steering_from=self.memory["steering"],
            steering_left=seconds,
            steering_seconds=seconds,
            amplitude=sign * self._uniform(shape, 0, 1).sqrt(),  # large ones more often
            slow=self._uniform(shape, 0.3, 1.0),  # [Hz]
            fast=self._uniform(shape, 1.0, 4.0),
        )

    def _draw_throttle(self, speed: Tensor) -> None:
        stands = (self.memory["throttle_kind"] == STOP) & (speed < STANDING_SPEED)
        self.memory["throttle_left"] = torch.where(
            stands,
            self.memory["throttle_left"].clamp_max(STANDING_SECONDS),
            self.memory["throttle_left"],
        )
        ended, shape = self.memory["throttle_left"] <= 0, self.memory["side"].shape
        self.memory["throttle_left"] = self.memory["throttle_left"] - self.dt
        if not ended.any():
            return
        kind = self._chosen(shape, THROTTLE_CHANCES)
        low, high = torch.tensor(THROTTLE_SECONDS).float()[kind].unbind(-1)
        seconds = low + (high - low) * self._uniform(shape, 0, 1)
        slowest, fastest = torch.tensor(SPEEDS)[self._chosen(shape, SPEED_CHANCES)].unbind(-1)
        self._renew(
            ended,
            throttle_kind=kind,
            throttle_left=seconds,
            throttle_seconds=seconds,
            speed=slowest + (fastest - slowest) * self._uniform(shape, 0, 1),
            period=self._uniform(shape, 0.3, 0.9),
        )

    def _steering(self) -> Tensor:
        m = self.memory
        time = m["steering_seconds"] - m["steering_left"]
        share = time / m["steering_seconds"]
        turns = m["slow"] * time + 0.5 * (m["fast"] - m["slow"]) * time * share
        by_kind = torch.stack(
            [
                m["amplitude"],
                m["steering_from"] + (m["amplitude"] - m["steering_from"]) * share,
                m["amplitude"] * torch.sin(2 * math.pi * turns),
                m["amplitude"] * torch.sign(torch.sin(2 * math.pi * m["slow"] * time)),
                m["amplitude"] * STRAIGHT_AMPLITUDE,
            ]
        )
        return by_kind.gather(0, m["steering_kind"].long().unsqueeze(0)).squeeze(0)

    def _drive(self, speed: Tensor) -> Tensor:
        m = self.memory
        time = m["throttle_seconds"] - m["throttle_left"]
        steady = self._holding(m["speed"])
        off = torch.zeros_like(steady)
        by_kind = torch.stack(
            [
                off,
                off,
                steady + 0.3 * (m["speed"] - speed),
                steady,
                off + 1.0,
                steady * 1.2 * time / m["throttle_seconds"],
                1.5 * steady * (torch.sin(2 * math.pi * time / m["period"]) > 0),
            ]
        )
        return by_kind.gather(0, m["throttle_kind"].long().unsqueeze(0)).squeeze(0)

    def _holding(self, speed: Tensor) -> Tensor:
        return self.config.drive_at_rest + self.config.drive_per_speed * speed

    def _kept_inside(
        self, pose: Tensor, velocity: Tensor, speed: Tensor, drive: Tensor, steering: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Cuts the throttle, then turns, while a turn at this speed still fits into the room."""
        now = self._room_to_turn(pose, velocity, speed)  # (2, *) to the left, to the right
        faster = self._room_to_turn(pose, velocity, speed + FULL_THROTTLE_GAIN * drive)
        held = torch.minimum(drive, self._holding(speed.clamp_min(CREEPING_SPEED)))
        drive = torch.where(faster.amax(0) < 0, held, drive)
        side = self._side_to_turn(now)
        gentle = torch.minimum(drive, self._holding(speed.clamp(CREEPING_SPEED, TURNING_SPEED)))
        creeping = self._holding(torch.full_like(speed, CREEPING_SPEED))
        gentle = torch.where(speed < SLOW, creeping, gentle)  # or it would stand facing the wall
        amount = 0.8 + 0.2 * self.memory["amplitude"].abs()
        return (
            torch.where(side != 0, gentle, drive),
            torch.where(side != 0, side * amount, steering),
        )

    def _side_to_turn(self, room: Tensor) -> Tensor:
        """Which way [*] to turn from the walls, +1 left, -1 right, 0 not now.

        Begins when the better way just fits, ends when there is `CLEAR_ROOM` again, and changes
        its mind only when the chosen way is lost and the other is not.
        """
        best, side = room.amax(0), self.memory["side"]
        better = torch.where(room[0] >= room[1], 1.0, -1.0)
        chosen = torch.where(side >= 0, room[0], room[1])
        lost = (side != 0) & (chosen < 0) & (best > 0.3 * CLEAR_ROOM)
        clear = (side != 0) & (best > CLEAR_ROOM)
        side = torch.where(((side == 0) & (best < 0)) | lost, better, side)
        self.memory["side"] = torch.where(clear, 0.0, side)
        self._cross(clear & (self._uniform(side.shape, 0, 1) < CROSSING_CHANCE))
        return self.memory["side"]

    def _cross(self, mask: Tensor) -> None:
        """Away from a wall the room is at its longest: straight and fast, often with a burst."""
        fast = self._uniform(mask.shape, *SPEEDS[-1])
        burst = self.memory["amplitude"] > 0
        self._renew(
            mask,
            steering_kind=torch.full_like(fast, STEERING_KINDS.index("straight")),
            steering_left=torch.ones_like(fast),
            throttle_kind=torch.where(
                burst, THROTTLE_KINDS.index("burst"), THROTTLE_KINDS.index("hold_speed")
            ),
            throttle_left=torch.where(burst, 0.5, 1.5),
            throttle_seconds=torch.where(burst, 0.5, 1.5),
            speed=fast,
        )

    def _kept_straight(self, velocity: Tensor, drive: Tensor, steering: Tensor) -> Tensor:
        """Less throttle the more the car is steered, none once its tail comes round."""
        vx, vy, _ = velocity.unbind(-1)
        drift = torch.atan2(vy, vx.clamp_min(SLOW))
        sliding = (drift.abs() > LARGEST_DRIFT) | (vx < -SLOW)
        eased = torch.minimum(drive, 1.0 - (1.0 - STEERED_DRIVE) * steering.abs())
        return torch.where(sliding, 0.0, eased)

    def _room_to_turn(self, pose: Tensor, velocity: Tensor, speed: Tensor) -> Tensor:
        """How far [2, *] [m] the circle to the left and to the right stays off the walls.

        After the reaction time the car turns with R = sqrt(R0^2 + (v^2 / a)^2).
        """
        config = self.config
        moving = torch.linalg.vector_norm(velocity[..., :2], dim=-1) > SLOW
        drift = torch.atan2(velocity[..., 1], velocity[..., 0])
        turn = velocity[..., 2] * config.reaction
        course = pose[..., 2] + torch.where(moving, drift, 0.0)
        way = torch.stack([speed * config.reaction, torch.zeros_like(speed)], -1)
        ahead = pose[..., :2] + rotate(way, course + 0.5 * turn)
        radius = torch.sqrt(
            config.turning_radius**2 + (speed.square() / config.lateral_acceleration).square()
        )
        left = rotate(torch.stack([torch.zeros_like(radius), radius], -1), course + turn)
        centres = torch.stack([ahead + left, ahead - left])  # (2, *, 2)
        return config.size / 2 - config.clearance - radius - centres.abs().amax(-1)

    def _thumbed(self, throttle: Tensor, steering: Tensor) -> Tensor:
        step = self.config.thumb_rate * self.dt
        for name, wanted in (("throttle", throttle), ("steering", steering)):
            last = self.memory[name] if name == "steering" else self.memory[name] - 1.0
            moved = last + (wanted - last).clamp(-step, step)
            self.memory[name] = moved if name == "steering" else moved + 1.0
        return torch.stack([self.memory["throttle"] - 1.0, self.memory["steering"]], -1)
