"""Manoeuvres as a hypothesis would have them recorded, and where a simulator is trusted in them."""

import torch
from tensordict import TensorDict
from torch import Tensor

from buggy_rl import keys
from buggy_rl.diagnosis.candidate import Candidate
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.rollout import sensed
from buggy_rl.estimation.segments import Segments
from buggy_rl.longitudinal import declared_by
from buggy_rl.recordings import Recording

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
