"""The tracking camera: what a recording shows of the motion that really happened."""

from dataclasses import dataclass

import torch
from torch import Tensor

from buggy_rl.vehicle import shift_pose, shift_velocity


@dataclass(frozen=True)
class CameraConfig:
    """Errors of a visual-inertial tracking camera on the car, one standard deviation each.

    The defaults are chosen, not measured: such a camera smooths its pose well over a fraction of a
    second (under a millimetre), while its velocities carry vibration and the gyroscope's noise.
    They are white from row to row; slow drift of the pose is left out, because no model here sees
    more than a few seconds.
    """

    position_noise: float = 0.0007
    """Each of x and y [m]."""
    yaw_noise: float = 0.002
    """[rad]"""
    velocity_noise: float = 0.025
    """Each of vx and vy [m/s]."""
    yaw_rate_noise: float = 0.03
    """[rad/s]"""
    lever_arm_x: float = 0.0
    """How far ahead of its nominal place the camera sits [m]."""
    lever_arm_y: float = 0.0
    """How far left of its nominal place the camera sits [m]."""
    latency: float = 0.0
    """Age of what is reported [s]."""
    dropped_share: float = 0.0
    """Share of frames that never arrive."""


class Camera:
    """Measures motions row by row.

    Args:
        config: Its errors.
        seed: Of its noise; two cameras with one seed measure one motion alike.

    Raises:
        ValueError: A standard deviation or the latency is negative, or every frame is dropped.
    """

    def __init__(self, config: CameraConfig | None = None, seed: int = 0) -> None:
        self.config = config or CameraConfig()
        for name in ("position_noise", "yaw_noise", "velocity_noise", "yaw_rate_noise", "latency"):
            if getattr(self.config, name) < 0:
                raise ValueError(f"camera {name} is {getattr(self.config, name)}: must be >= 0")
        if not 0 <= self.config.dropped_share < 1:
            raise ValueError(
                f"camera dropped_share is {self.config.dropped_share}: must be in [0, 1)"
            )
        self._generator = torch.Generator().manual_seed(seed)

    def measure(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Measured from true motion.

        z(t) = p(t - latency) + L + e,  e ~ N(0, sigma^2), with L the lever arm's share. Before
        the first row the motion is taken to be that of the first row.

        Args:
            pose: [T, *, 3] x, y [m], yaw [rad] in the world frame, yaw unwrapped.
            velocity: [T, *, 3] vx, vy [m/s], yaw_rate [rad/s] at the nominal place.
            dt: Time between rows [s].

        Returns:
            Both as measured, same shapes.
        """
        config = self.config
        pose, velocity = (delayed(signal, config.latency / dt) for signal in (pose, velocity))
        pose = shift_pose(pose, config.lever_arm_x, config.lever_arm_y)
        velocity = shift_velocity(velocity, config.lever_arm_x, config.lever_arm_y)
        pose_noise = (config.position_noise, config.position_noise, config.yaw_noise)
        velocity_noise = (config.velocity_noise, config.velocity_noise, config.yaw_rate_noise)
        return pose + self._noise(pose, pose_noise), velocity + self._noise(
            velocity, velocity_noise
        )

    def arrived(self, rows: int) -> Tensor:
        """[T] bool: which frames are not dropped; the first always arrives."""
        kept = torch.rand(rows, generator=self._generator) >= self.config.dropped_share
        kept[:1] = True
        return kept

    def _noise(self, like: Tensor, deviation: tuple[float, float, float]) -> Tensor:
        noise = torch.randn(like.shape, generator=self._generator) * torch.tensor(deviation)
        return noise.to(like)


def delayed(signal: Tensor, rows: float) -> Tensor:
    """The signal [T, *] as it was `rows` >= 0 rows ago, linear between rows, held at the start."""
    whole = int(rows)
    share = rows - whole
    index = torch.arange(len(signal), device=signal.device)
    newer = signal[(index - whole).clamp_min(0)]
    older = signal[(index - whole - 1).clamp_min(0)]
    return newer if share == 0 else newer + share * (older - newer)
