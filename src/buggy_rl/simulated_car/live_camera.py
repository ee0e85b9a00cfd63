"""The tracking camera, one row at a time."""

import math
from collections import deque

import torch
from torch import Tensor

from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.vehicle import CONTROL_PERIOD

Triple = tuple[float, float, float]


class LiveCamera:
    """Measures motion as it happens; keeps only as many rows as its latency needs.

    Args:
        config: Errors of the camera, without a lag.
        seed: Of its noise.
    """

    def __init__(self, config: CameraConfig, seed: int) -> None:
        self._camera = Camera(config, seed)
        rows = 2 + math.ceil(config.latency / CONTROL_PERIOD)
        self._rows: deque[tuple[Tensor, Tensor]] = deque(maxlen=rows)

    def see(self, pose: Tensor, velocity: Tensor) -> tuple[Triple, Triple] | None:
        """Pose and velocity as measured of the true ones [3], or None for a dropped frame."""
        self._rows.append((pose, velocity))
        poses, velocities = (torch.stack(rows) for rows in zip(*self._rows, strict=True))
        measured = self._camera.measure(poses, velocities, CONTROL_PERIOD)
        x, y, yaw = measured[0][-1].tolist()
        vx, vy, yaw_rate = measured[1][-1].tolist()
        dropped = not self._camera.arrived(2)[1]
        return None if dropped else ((x, y, yaw), (vx, vy, yaw_rate))
