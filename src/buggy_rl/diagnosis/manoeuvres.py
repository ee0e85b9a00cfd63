"""Manoeuvres that a person can drive in a room, as commands over time."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.longitudinal import ONE_WAY_REST, command_of

STAND = 0.5  # [s] at rest before each: latent states settle
ROLL = 1.0  # [s] without drive after each


@dataclass(frozen=True)
class Manoeuvre:
    """Words for a driver, and commands for a simulator."""

    name: str
    words: str
    seconds: float
    command: Callable[[Tensor], tuple[Tensor, Tensor]]
    """Times [T] [s] -> drive in 0..1 and steering in -1..1, [T] each."""

    def actions(self, dt: float, rest: float = ONE_WAY_REST) -> Tensor:
        """Commands [T, 2]: at rest, the manoeuvre, then rolling without drive.

        Args:
            dt: Control period [s].
            rest: Command without drive.
        """
        before, after = round(STAND / dt), round(ROLL / dt)
        time = torch.arange(round(self.seconds / dt)) * dt
        drive, steering = self.command(time)
        driven = torch.stack([command_of(drive, rest), steering], -1).float()
        idle = torch.tensor([rest, 0.0]).expand(max(before, after), 2)
        return torch.cat([idle[:before], driven.clamp(-1.0, 1.0), idle[:after]])


def _constant(drive: float, steering: float):
    return lambda t: (torch.full_like(t, drive), torch.full_like(t, steering))


def _square(t: Tensor, period: float) -> Tensor:
    return torch.where((t / period) % 1.0 < 0.5, 1.0, -1.0)


MANOEUVRES = (
    Manoeuvre("full_throttle", "full-throttle straight, 1.5 s", 1.5, _constant(1.0, 0.0)),
    Manoeuvre(
        "coast",
        "accelerate for 1.2 s on a straight, then let it roll to a stop",
        4.0,
        lambda t: (torch.where(t < 1.2, 0.7, 0.0), torch.zeros_like(t)),
    ),
    Manoeuvre(
        "throttle_steps",
        "straight, throttle on and off every 0.6 s",
        4.0,
        lambda t: (torch.where(_square(t, 1.2) > 0, 0.5, 0.0), torch.zeros_like(t)),
    ),
    Manoeuvre(
        "creep",
        "open the throttle very slowly from nothing on a straight, 4 s",
        4.0,
        lambda t: (0.1 * t, torch.zeros_like(t)),
    ),
    Manoeuvre("circle_slow", "slow circle to the left, 4 s", 4.0, _constant(0.28, 0.6)),
    Manoeuvre("circle_slow_right", "slow circle to the right, 4 s", 4.0, _constant(0.28, -0.6)),
    Manoeuvre("circle_fast", "fast circle to the left, 4 s", 4.0, _constant(0.5, 0.7)),
    Manoeuvre("circle_fast_right", "fast circle to the right, 4 s", 4.0, _constant(0.5, -0.7)),
    Manoeuvre(
        "steering_steps",
        "steady speed, steering from half left to half right and back every 0.8 s",
        4.0,
        lambda t: (torch.full_like(t, 0.35), 0.5 * _square(t, 1.6)),
    ),
    Manoeuvre(
        "small_steering_steps",
        "steady speed, small quick steering steps left and right",
        4.0,
        lambda t: (torch.full_like(t, 0.35), 0.15 * _square(t, 1.0)),
    ),
    Manoeuvre(
        "slalom",
        "steady speed, slalom from full left to full right once a second",
        4.0,
        lambda t: (torch.full_like(t, 0.35), torch.sin(2 * torch.pi * t)),
    ),
    Manoeuvre(
        "slow_slalom",
        "steady speed, wide slalom, once in three seconds",
        6.0,
        lambda t: (torch.full_like(t, 0.35), 0.6 * torch.sin(2 * torch.pi * t / 3)),
    ),
)
