"""A driver with little excitation: near-constant speed and wide bends."""

import math

import torch
from torch import Tensor

from buggy_rl.policies.controllers.room import RoomDriver

SPEED = 1.5  # [m/s] speed; a walking pace
PERIOD = 9.0  # [s] of the slalom
STEERED = 0.35  # [command] amplitude of the slalom


class SteadyDriver(RoomDriver):
    """Holds one speed in a slow slalom, and turns away from the walls as the room driver does."""

    def reset(self, batch_size) -> None:
        """Forgets the last drive and begins at a random phase of the slalom."""
        super().reset(batch_size)
        self.memory["phase"] = self._uniform(torch.Size(batch_size), 0.0, 2 * math.pi)

    def _steering(self) -> Tensor:
        self.memory["phase"] = self.memory["phase"] + 2 * math.pi * self.dt / PERIOD
        return STEERED * torch.sin(self.memory["phase"])

    def _drive(self, speed: Tensor) -> Tensor:
        return self._holding(torch.full_like(speed, SPEED)) + 0.3 * (SPEED - speed)
