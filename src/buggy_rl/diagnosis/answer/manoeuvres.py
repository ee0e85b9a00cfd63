"""Manoeuvres for a room, and how hypotheses would have them recorded."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import ONE_WAY_REST, command_of, declared_by
from buggy_rl.diagnosis.search.candidate import Candidate
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.rollout import sensed
from buggy_rl.estimation.segments import Segments
from buggy_rl.recordings import Recording

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


TIMES = 6  # as often as a manoeuvre is expected to be driven, each time facing another way,
HEADINGS = 3  # of which as many are simulated
# A simulator is trusted up to so many times the 95 % quantile of the driven speed and lateral
# acceleration.
TRUSTED, ALMOST = (1.5, 1.2), 0.95


def trusted(driven: Segments, segments: Segments, outside: Tensor) -> Tensor:
    """Which segments [N] of manoeuvres a simulator is trusted in.

    Segments much faster than what was driven tell nothing: there it may be wrong in other ways. Nor
    do those that a learned simulator reports as outside its training range.
    """
    rows = segments.row.unsqueeze(-1) + torch.arange(segments.pose.shape[1])  # (N, L)
    found = ~outside[segments.recording.unsqueeze(-1), rows].any(-1)
    for most, asked, beyond in zip(_pace(driven), _pace(segments), TRUSTED, strict=True):
        found &= asked <= beyond * most.quantile(ALMOST)
    return found


def _pace(segments: Segments) -> tuple[Tensor, Tensor]:
    """Highest speed [m/s] and lateral acceleration [m/s^2] of segments, [N] each."""
    vx, yaw_rate = segments.smooth_velocity[..., 0], segments.smooth_velocity[..., 2]
    return vx.abs().amax(-1), (vx * yaw_rate).abs().amax(-1)


def simulated(problem: Problem, truth: Candidate) -> tuple[list[Recording], Tensor]:
    """What the sensor would show of all manoeuvres, `HEADINGS` of each, one after the other.

    Returns:
        Recordings, and which of their rows [recordings, T] the simulator calls out of its range.
    """
    dt = problem.segments.dt
    rest = declared_by(problem.simulation.make(1)).rest
    actions = [m.actions(dt, rest) for m in MANOEUVRES for _ in range(HEADINGS)]
    longest, count = max(map(len, actions)), len(actions)
    idle = torch.tensor([rest, 0.0])
    padded = torch.stack([torch.cat([a, idle.expand(longest - len(a), 2)]) for a in actions])
    settings = problem.library.settings([(truth.fit, truth.fit.vector)])
    start = TensorDict(
        {keys.POSE: torch.zeros(count, 3), keys.VELOCITY: torch.zeros(count, 3)}, [count]
    )
    start[keys.POSE][:, 2] = 2 * torch.pi / HEADINGS * (torch.arange(count) % HEADINGS)
    shown, outside = [], []
    inside = torch.zeros(count, 1, dtype=torch.bool)
    for state in problem.simulation.drive(padded, settings, start):
        shown.append(sensed(state))
        outside.append(state.get(keys.OUT_OF_RANGE, inside).flatten())
    read = torch.stack(shown, 1)  # (count, T, 6)
    recordings = [
        Recording(f"manoeuvre_{index}", _as_recorded(read[index, : len(a)], a, dt), dt)
        for index, a in enumerate(actions)
    ]
    return recordings, torch.stack(outside, 1)


def _as_recorded(shown: Tensor, action: Tensor, dt: float) -> TensorDict:
    """A recording [T] of what was shown [T, 6] under actions [T, 2]."""
    time = dt * torch.arange(len(shown), dtype=torch.float64)
    return TensorDict(
        {
            keys.TIME: time.unsqueeze(-1),
            keys.POSE: shown[:, :3].clone(),
            keys.VELOCITY: shown[:, 3:].clone(),
            keys.ACTION: action,
            keys.SEGMENT: torch.zeros(len(shown), dtype=torch.long),
        },
        [len(shown)],
    )
