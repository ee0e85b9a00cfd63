"""Small recordings with identifiable values."""

import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.core.vehicle import integrate_pose
from buggy_rl.recordings.recording import Recording


def counting_drive(name: str, rows: int, segments: list[int] | None = None) -> Recording:
    """Every value is a multiple of its row, so a shifted window shows as arithmetic."""
    row = torch.arange(rows, dtype=torch.float32)
    data = TensorDict(
        {
            keys.TIME: 0.01 * row.double()[:, None],
            keys.POSE: torch.stack([row, 1000 + row, 0 * row], -1),
            keys.VELOCITY: torch.stack([row, 10 * row, 100 * row], -1),
            keys.ACTION: torch.stack([row, -row], -1),
            keys.SEGMENT: torch.zeros(rows, dtype=torch.long),
        },
        [rows],
    )
    for first in segments or []:
        data[keys.SEGMENT][first:] += 1
    return Recording(name, data, 0.01)


def toy_drive(name: str, rows: int, seed: int, noise: float = 0.0) -> Recording:
    """A car with three linear equations, driven from rest by smooth random commands.

    vx' = vx + 0.01 (4 u - 1.5 vx), vy' = vy + 0.01 (-0.5 r - 5 vy), r' = r + 0.01 * 8 (s vx - r),
    u = (throttle + 1) / 2.
    """
    generator = torch.Generator().manual_seed(seed)
    knots = torch.rand((rows // 40 + 2, 2), generator=generator) * 2 - 1
    action = torch.nn.functional.interpolate(
        knots.T[None], rows, mode="linear", align_corners=True
    )[0].T
    action[:30, 0] = -1
    pose, velocity = torch.zeros(3), torch.zeros(3)
    poses, velocities = [], []
    for throttle, steering in action:
        poses.append(pose)
        velocities.append(velocity)
        vx, vy, yaw_rate = velocity
        change = torch.stack(
            [
                2 * (throttle + 1) - 1.5 * vx,
                -0.5 * yaw_rate - 5 * vy,
                8 * (steering * vx - yaw_rate),
            ]
        )
        following = velocity + 0.01 * change
        pose = integrate_pose(pose, velocity, following, 0.01)
        velocity = following
    measured = torch.stack(velocities) + noise * torch.randn((rows, 3), generator=generator)
    data = TensorDict(
        {
            keys.TIME: 0.01 * torch.arange(rows, dtype=torch.float64)[:, None],
            keys.POSE: torch.stack(poses),
            keys.VELOCITY: measured,
            keys.ACTION: action.contiguous(),
            keys.SEGMENT: torch.zeros(rows, dtype=torch.long),
        },
        [rows],
    )
    return Recording(name, data, 0.01)
