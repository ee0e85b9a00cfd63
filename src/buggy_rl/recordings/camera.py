"""The tracking camera: measurement errors of the recorded motion."""

import math
from dataclasses import dataclass

import torch
from scipy.signal import lfilter
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD, rotate, shift_pose, shift_velocity

DECIMALS = 5  # of every recorded number: 10 micrometres, a seventieth of the position noise


@dataclass(frozen=True)
class CameraConfig:
    """Errors of a visual-inertial tracking camera on the car; noises are standard deviations.

    The defaults are chosen, not measured: such a camera smooths its pose over a fraction of a
    second (under a millimetre), while its velocities carry vibration and the gyroscope's noise.
    The noise is white; slow drift of the pose is left out, because a rollout segment lasts a few
    seconds.
    """

    position_noise: float = 0.0007
    """Noise of each of x and y [m]."""
    yaw_noise: float = 0.002
    """Noise of yaw [rad]."""
    velocity_noise: float = 0.025
    """Noise of each of vx and vy [m/s]."""
    yaw_rate_noise: float = 0.03
    """Noise of the yaw rate [rad/s]."""
    lever_arm_x: float = 0.0
    """Position of the camera ahead of its nominal one [m]."""
    lever_arm_y: float = 0.0
    """Position of the camera to the left of its nominal one [m]."""
    yaw: float = 0.0
    """Rotation of the camera to the left [rad]."""
    latency: float = 0.0
    """Dead time of all measurements [s]."""
    lag: float = 0.0
    """Time constant of a first-order filter on all measurements [s]."""
    pose_scale: float = 1.0
    """Measured over true lengths: x, y, vx, vy."""
    heading_drift: float = 0.0
    """Growth of the heading's error [rad/s], from 0 at the first row; the path bends with it."""
    speed_scale: float = 1.0
    """Measured over true vx and vy; the position is right."""
    gyro_bias: float = 0.0
    """Added to the measured yaw rate [rad/s]; yaw is right."""
    dropped_share: float = 0.0
    """Share of dropped frames."""


NOISES = ("position_noise", "yaw_noise", "velocity_noise", "yaw_rate_noise")


class Camera:
    """Measures motions row by row.

    Args:
        config: Its errors.
        seed: Of its noise; equal seeds give equal measurements.

    Raises:
        ValueError: A standard deviation or a time is negative, the scale of the speed is not
            positive, or every frame is dropped.
    """

    def __init__(self, config: CameraConfig | None = None, seed: int = 0) -> None:
        self.config = config or CameraConfig()
        for name in (*NOISES, "latency", "lag"):
            if getattr(self.config, name) < 0:
                raise ValueError(f"camera {name} is {getattr(self.config, name)}: must be >= 0")
        for name in ("speed_scale", "pose_scale"):
            if getattr(self.config, name) <= 0:
                raise ValueError(f"camera {name} is {getattr(self.config, name)}: must be > 0")
        if not 0 <= self.config.dropped_share < 1:
            raise ValueError(
                f"camera dropped_share is {self.config.dropped_share}: must be in [0, 1)"
            )
        self._generator = torch.Generator().manual_seed(seed)

    def measure(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Measured pose and velocity of true motion.

        z(t) = S f(p + L)(t - latency) + b + e,  e ~ N(0, sigma^2), with L the lever arm and
        rotation of the camera, f the filter, S the scales and b the gyroscope bias; a drifting
        heading bends the path. Before the first row the motion is that of the first row.

        Args:
            pose: [T, *, 3] x, y [m], yaw [rad] in the world frame, yaw unwrapped.
            velocity: [T, *, 3] vx, vy [m/s], yaw_rate [rad/s] at the nominal camera position.
            dt: Time between rows [s].

        Returns:
            Both as measured, same shapes.
        """
        config = self.config
        pose, velocity = (delayed(signal, config.latency / dt) for signal in (pose, velocity))
        pose = shift_pose(pose, config.lever_arm_x, config.lever_arm_y)
        velocity = shift_velocity(velocity, config.lever_arm_x, config.lever_arm_y)
        if config.yaw:
            pose, velocity = _turned(pose, velocity, config.yaw)
        if config.lag:
            pose, velocity = (lagging(signal, config.lag / dt) for signal in (pose, velocity))
        if config.heading_drift:
            pose = drifting(pose, config.heading_drift * dt)
        length, speed = config.pose_scale, config.pose_scale * config.speed_scale
        pose = pose * pose.new_tensor((length, length, 1.0))
        velocity = velocity * velocity.new_tensor((speed, speed, 1.0))
        velocity = velocity + velocity.new_tensor((0.0, 0.0, config.gyro_bias))
        pose_noise = (config.position_noise, config.position_noise, config.yaw_noise)
        velocity_noise = (config.velocity_noise, config.velocity_noise, config.yaw_rate_noise)
        return pose + self._noise(pose, pose_noise), velocity + self._noise(
            velocity, velocity_noise
        )

    def recorded(self, motion: TensorDictBase, dt: float = CONTROL_PERIOD) -> TensorDict:
        """Data of a recording of a motion; dropped frames leave gaps.

        Args:
            motion: [T] true `pose`, `velocity` and `action`.
            dt: Time between rows [s].

        Returns:
            TensorDict [T'] with `t`, `pose`, `velocity`, `action` and `segment`.
        """
        pose, velocity = self.measure(motion[keys.POSE], motion[keys.VELOCITY], dt)
        row = torch.nonzero(self.arrived(len(motion)))[:, 0]  # (T',)
        columns = {keys.POSE: pose, keys.VELOCITY: velocity, keys.ACTION: motion[keys.ACTION]}
        data = {key: value.round(decimals=DECIMALS)[row] for key, value in columns.items()}
        data[keys.TIME] = (row.double() * dt).round(decimals=DECIMALS).unsqueeze(-1)
        data[keys.SEGMENT] = (row.diff(prepend=row[:1]) > 1).cumsum(0)
        return TensorDict(data, len(row))

    def arrived(self, rows: int) -> Tensor:
        """[T] bool: frames that are not dropped; the first never is."""
        kept = torch.rand(rows, generator=self._generator) >= self.config.dropped_share
        kept[:1] = True
        return kept

    def _noise(self, like: Tensor, deviation: tuple[float, float, float]) -> Tensor:
        noise = torch.randn(like.shape, generator=self._generator) * torch.tensor(deviation)
        return noise.to(like)


def delayed(signal: Tensor, rows: float) -> Tensor:
    """Delays a signal [T, *] by `rows` >= 0 rows: linear between rows, constant at the start."""
    whole = int(rows)
    share = rows - whole
    index = torch.arange(len(signal), device=signal.device)
    newer = signal[(index - whole).clamp_min(0)]
    older = signal[(index - whole - 1).clamp_min(0)]
    return newer if share == 0 else newer + share * (older - newer)


def _turned(pose: Tensor, velocity: Tensor, angle: float) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] measured by a camera rotated to the left by `angle` [rad]."""
    yaw = pose[..., 2:] + angle
    course = rotate(velocity[..., :2], torch.full_like(velocity[..., 2], -angle))
    return torch.cat([pose[..., :2], yaw], -1), torch.cat([course, velocity[..., 2:]], -1)


def drifting(pose: Tensor, turn: float) -> Tensor:
    """Pose [T, *, 3] of odometry whose heading is off by `turn` [rad] more from row to row.

    Each way between two rows is laid out along the heading in the middle of both errors.
    """
    row = torch.arange(len(pose), dtype=torch.float64, device=pose.device)
    error = (turn * row).reshape(-1, *(1,) * (pose.dim() - 2)).expand(pose.shape[:-1])
    way = pose[..., :2].double().diff(dim=0)
    ways = rotate(way, 0.5 * (error[1:] + error[:-1]))
    start = pose[:1, ..., :2].double()
    position = torch.cat([start, start + ways.cumsum(0)])
    return torch.cat([position, pose[..., 2:] + error.unsqueeze(-1)], -1).to(pose.dtype)


def lagging(signal: Tensor, rows: float) -> Tensor:
    """Filters a signal [T, *] by a first-order lag of `rows` > 0 rows, settled at the start.

    T dz/dt = x - z, exact for a signal that is linear between rows: the difference e = z - x
    follows e' = a e - (1 - a) T (x' - x) with a = exp(-1 / T).
    """
    decay = math.exp(-1.0 / rows)
    step = signal.diff(dim=0, prepend=signal[:1]).double().cpu().numpy()
    difference = lfilter([-(1.0 - decay) * rows], [1.0, -decay], step, axis=0)
    return (signal.double() + torch.as_tensor(difference).to(signal.device)).to(signal.dtype)
