"""What kinds of sensors make of a true motion: rate, noise, jitter, leaps, frozen poses, holes."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from numpy import ndarray
from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.config import from_plain
from buggy_rl.recordings.camera import Camera, CameraConfig

MINUTE = 60.0  # [s]
LEAPING = (1, 3)  # rows that a leap lasts, the end excluded: shorter than 0.1 s at 30 Hz
FROZEN = (2, 5)  # rows that repeat the one before them, the end excluded


@dataclass(frozen=True)
class SensorErrors:
    """Errors of one kind of sensor."""

    rate: float = 100.0
    """Poses a second [Hz]."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    """Noise, mount, latency."""
    jitter: float = 0.0
    """Standard deviation of a stamp, in periods."""
    leaps: float = 0.0
    """Glitches a minute: the position leaps and returns."""
    leap: float = 0.3
    """Length of a leap [m]."""
    freezes: float = 0.0
    """Times a minute that the pose repeats bit for bit for a few rows."""
    holes: float = 0.0
    """Times a minute that rows are missing,"""
    hole: tuple[float, float] = (0.1, 0.6)
    """[s] for so long."""
    gyro: float = 0.02
    """Noise of a gyroscope beside it [rad/s]; chosen."""
    wheel: float = 0.03
    """Noise of a wheel speed beside it [m/s]; chosen."""

    def __post_init__(self) -> None:
        for name in ("jitter", "leaps", "freezes", "holes"):
            if getattr(self, name) < 0:
                raise ValueError(f"sensor {name} is {getattr(self, name)}: must be >= 0")
        if self.rate <= 0:
            raise ValueError(f"sensor rate is {self.rate} Hz: must be > 0")


def _noise(position: float, yaw: float, velocity: float, yaw_rate: float) -> CameraConfig:
    return CameraConfig(position, yaw, velocity, yaw_rate)


SENSORS = {
    "tracking_camera": SensorErrors(),
    # 0.95 mm: what the estimator finds in the DART recordings (docs/evidence.md); the rest chosen.
    "motion_capture": SensorErrors(camera=_noise(0.00095, 0.003, 0.03, 0.05), jitter=0.02),
    # 2 cm: FrictionMaps (configs/columns/frictionmaps.yaml); the rest chosen.
    "lidar": SensorErrors(40.0, _noise(0.02, 0.01, 0.1, 0.03), jitter=0.1),
    # RTK position, heading by two antennas or filter, gyroscope; chosen.
    "gps": SensorErrors(50.0, _noise(0.02, 0.005, 0.05, 0.005), jitter=0.05),
}
"""Kind of sensor in a car's file -> its errors."""


def sensor_errors(kind: str, changes: Mapping[str, Any] | None = None) -> SensorErrors:
    """Errors of a kind of sensor, some of them changed.

    Raises:
        ValueError: There is no such kind, or no such error.
    """
    if kind not in SENSORS:
        raise ValueError(f"no sensor {kind!r}; available: {', '.join(SENSORS)}")
    changes = dict(changes or {})
    camera = {**asdict(SENSORS[kind].camera), **changes.pop("camera", {})}
    changed: dict[str, Any] = {**asdict(SENSORS[kind]), **changes, "camera": camera}
    changed["hole"] = tuple(changed["hole"])
    return from_plain(SensorErrors, changed, f"sensor {kind}")


def sensor_columns(
    motion: TensorDictBase, errors: SensorErrors, dt: float, seed: int
) -> dict[str, ndarray]:
    """Columns of a table of what a sensor shows of a motion; rows in holes are left out.

    Args:
        motion: [T] true `pose`, `velocity` and `action`.
        errors: Of the sensor.
        dt: Time between rows of the motion [s].
        seed: Of all that is drawn.

    Returns:
        t, x, y, yaw, vx, vy, yaw_rate, throttle, steering, gyro, wheel_speed, [T'] each, in SI
        units; wheels do not slip.
    """
    random = np.random.default_rng(seed)
    period, end = 1.0 / errors.rate, (len(motion) - 1) * dt
    t = np.arange(0.0, end, period)
    t = np.clip(t + random.normal(0.0, errors.jitter * period, len(t)), 0.0, end)
    t = np.maximum.accumulate(t) + 1e-6 * np.arange(len(t))  # stamps increase
    true = np.arange(len(motion)) * dt
    signals: list[Tensor] = [motion[keys.POSE], motion[keys.VELOCITY]]
    seen = [torch.as_tensor(_interpolated(t, true, np.asarray(s.double()))) for s in signals]
    pose, velocity = (
        np.asarray(v) for v in Camera(errors.camera, seed).measure(seen[0], seen[1], period)
    )
    _spoil(pose, errors, len(t) * period / MINUTE, random)
    held = np.clip(np.floor(t / dt + 1e-9).astype(int), 0, len(motion) - 1)
    command: Tensor = motion[keys.ACTION]
    action = np.asarray(command.double())[held]
    names = ("x", "y", "yaw", "vx", "vy", "yaw_rate", "throttle", "steering")
    values = np.concatenate([pose, velocity, action], -1)
    kept = _arrived(t, errors, random)
    columns = dict(zip(names, values.T, strict=True)) | _beside(seen[1].numpy(), errors, seed)
    return {"t": t[kept]} | {name: column[kept] for name, column in columns.items()}


def _beside(velocity: ndarray, errors: SensorErrors, seed: int) -> dict[str, ndarray]:
    """Gyroscope and wheel speed [T] of a true velocity [T, 3], each with a noise of its own."""
    noise = np.random.default_rng([seed, 1]).standard_normal((2, len(velocity)))
    return {
        keys.GYRO: velocity[:, 2] + errors.gyro * noise[0],
        keys.WHEEL_SPEED: velocity[:, 0] + errors.wheel * noise[1],
    }


def _interpolated(t: ndarray, true: ndarray, values: ndarray) -> ndarray:
    return np.stack([np.interp(t, true, column) for column in values.T], -1)


def _spoil(pose: ndarray, errors: SensorErrors, minutes: float, random: Any) -> None:
    """Lets a pose [T, 3] leap and freeze, in place."""
    for _ in range(random.poisson(errors.leaps * minutes)):
        row, angle = random.integers(len(pose)), random.uniform(0, 2 * np.pi)
        rows = slice(row, row + random.integers(*LEAPING))
        pose[rows, :2] += errors.leap * np.array([np.cos(angle), np.sin(angle)])
    for _ in range(random.poisson(errors.freezes * minutes)):
        row = random.integers(len(pose))
        pose[row + 1 : row + random.integers(*FROZEN)] = pose[row]


def _arrived(t: ndarray, errors: SensorErrors, random: Any) -> ndarray:
    """Rows [T] that are not in a hole."""
    kept = np.ones(len(t), bool)
    for _ in range(random.poisson(errors.holes * (t[-1] - t[0]) / MINUTE)):
        begin = random.uniform(t[0], t[-1])
        kept &= (t < begin) | (t > begin + random.uniform(*errors.hole))
    return kept
