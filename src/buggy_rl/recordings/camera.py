"""The tracking camera: what a recording shows of the motion that really happened."""

import math
from dataclasses import dataclass

import torch
from scipy.signal import lfilter
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.vehicle import CONTROL_PERIOD, rotate, shift_pose, shift_velocity

DECIMALS = 5  # of every recorded number: 10 micrometres, a seventieth of the camera's noise


@dataclass(frozen=True)
class CameraConfig:
    """Errors of a visual-inertial tracking camera on the car; of noise, the standard deviations.

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
    yaw: float = 0.0
    """How far the camera is turned to the left of straight ahead [rad]."""
    latency: float = 0.0
    """Age of what is reported [s]."""
    lag: float = 0.0
    """Time constant of the filter that all it reports has passed [s]."""
    speed_scale: float = 1.0
    """Reported vx and vy over the true ones; the position is right."""
    gyro_bias: float = 0.0
    """Added to the reported yaw rate [rad/s]; the yaw is right."""
    dropped_share: float = 0.0
    """Share of frames that never arrive."""


NOT_NEGATIVE = (
    *("position_noise", "yaw_noise", "velocity_noise", "yaw_rate_noise"),
    *("latency", "lag"),
)


class Camera:
    """Measures motions row by row.

    Args:
        config: Its errors.
        seed: Of its noise; two cameras with one seed measure one motion alike.

    Raises:
        ValueError: A standard deviation or a time is negative, the scale of the speed is not
            positive, or every frame is dropped.
    """

    def __init__(self, config: CameraConfig | None = None, seed: int = 0) -> None:
        self.config = config or CameraConfig()
        for name in NOT_NEGATIVE:
            if getattr(self.config, name) < 0:
                raise ValueError(f"camera {name} is {getattr(self.config, name)}: must be >= 0")
        if self.config.speed_scale <= 0:
            raise ValueError(f"camera speed_scale is {self.config.speed_scale}: must be > 0")
        if not 0 <= self.config.dropped_share < 1:
            raise ValueError(
                f"camera dropped_share is {self.config.dropped_share}: must be in [0, 1)"
            )
        self._generator = torch.Generator().manual_seed(seed)

    def measure(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Measured from true motion.

        z(t) = S f(p + L)(t - latency) + b + e,  e ~ N(0, sigma^2), with L what the place and the
        turn of the camera change, f the filter, S and b the scale of the speed and the bias of the
        yaw rate. Before the first row the motion is taken to be that of the first row.

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
        if config.yaw:
            pose, velocity = turned(pose, velocity, config.yaw)
        if config.lag:
            pose, velocity = (lagging(signal, config.lag / dt) for signal in (pose, velocity))
        scale = (config.speed_scale, config.speed_scale, 1.0)
        velocity = velocity * velocity.new_tensor(scale)
        velocity = velocity + velocity.new_tensor((0.0, 0.0, config.gyro_bias))
        pose_noise = (config.position_noise, config.position_noise, config.yaw_noise)
        velocity_noise = (config.velocity_noise, config.velocity_noise, config.yaw_rate_noise)
        return pose + self._noise(pose, pose_noise), velocity + self._noise(
            velocity, velocity_noise
        )

    def recorded(self, drive: TensorDictBase, dt: float = CONTROL_PERIOD) -> TensorDict:
        """What a recording of a drive holds; dropped frames leave gaps.

        Args:
            drive: [T] true `pose`, `velocity` and `action`.
            dt: Time between rows [s].

        Returns:
            TensorDict [T'] with `t`, `pose`, `velocity`, `action` and `segment`.
        """
        pose, velocity = self.measure(drive[keys.POSE], drive[keys.VELOCITY], dt)
        row = torch.nonzero(self.arrived(len(drive)))[:, 0]  # (T',)
        columns = {keys.POSE: pose, keys.VELOCITY: velocity, keys.ACTION: drive[keys.ACTION]}
        data = {key: value.round(decimals=DECIMALS)[row] for key, value in columns.items()}
        data[keys.TIME] = (row.double() * dt).round(decimals=DECIMALS).unsqueeze(-1)
        data[keys.SEGMENT] = (row.diff(prepend=row[:1]) > 1).cumsum(0)
        return TensorDict(data, len(row))

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


def turned(pose: Tensor, velocity: Tensor, angle: float) -> tuple[Tensor, Tensor]:
    """Pose and velocity [*, 3] as seen by a camera turned to the left by `angle` [rad]."""
    yaw = pose[..., 2:] + angle
    course = rotate(velocity[..., :2], torch.full_like(velocity[..., 2], -angle))
    return torch.cat([pose[..., :2], yaw], -1), torch.cat([course, velocity[..., 2:]], -1)


def lagging(signal: Tensor, rows: float) -> Tensor:
    """The signal [T, *] behind a lag of `rows` > 0 rows, settled at the start.

    T dz/dt = x - z, exact for a signal that is straight between rows: what it lacks,
    e = z - x, follows e' = a e - (1 - a) T (x' - x) with a = exp(-1 / T).
    """
    decay = math.exp(-1.0 / rows)
    moved = signal.diff(dim=0, prepend=signal[:1]).double().cpu().numpy()
    lack = lfilter([-(1.0 - decay) * rows], [1.0, -decay], moved, axis=0)
    return (signal.double() + torch.as_tensor(lack).to(signal.device)).to(signal.dtype)
