"""The manoeuvring driver: the room driver of a car that also brakes, stops and reverses.

It drives forward as the room driver does, and in between brakes to a stand, rolls without a
command, or backs up while there is room behind.
"""

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.longitudinal import LongitudinalCommand, command_of
from buggy_rl.policies.controllers.recording import RoomConfig
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.vehicle import CONTROL_PERIOD, rotate

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
