"""What stands behind the sockets of a simulated car."""

import math
from dataclasses import dataclass, field
from typing import Any

from buggy_rl.recordings.camera import CameraConfig


@dataclass(frozen=True)
class SimulatedCarConfig:
    """The car, its camera, and how fast its time runs."""

    simulator: str = "reference"
    """An engine's name, a .yaml, a learned .pt, or file.py:factory."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further arguments of the engine, as options.command=throttle_brake_reverse."""
    two_way: bool = False
    """Whether its first command brakes and reverses: the runtime then stops it by 0, not by -1."""
    faults: dict[str, dict[str, float]] = field(default_factory=dict)
    """What is wrong with a reference car, as faults.EFFECT.PARAMETER=VALUE."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    """Errors of the camera; without noise a car that stands looks like a frozen sensor."""
    seed: int = 0
    """Seed of the camera's noise."""
    speed: float = 1.0
    """Speed of time; 4 drives a minute in 15 s where the simulator keeps up."""
    x: float = 0.0
    """Position along x at the start [m]."""
    y: float = 0.0
    """Position along y at the start [m]."""
    yaw: float = 0.0
    """Heading at the start [rad]."""
    failsafe: float = 0.0
    """Time without a write after which the board's own hardware makes neutral [s]; 0 has none."""
    compiled: bool = False
    """PyTorch compiles the reference car: 10 s to start, then 1 ms a step instead of 4."""

    def __post_init__(self) -> None:
        if not 0.1 <= self.speed <= 20:
            raise ValueError(f"speed={self.speed:g}: must be in [0.1, 20]")
        if not all(map(math.isfinite, (self.x, self.y, self.yaw))):
            raise ValueError(f"start ({self.x}, {self.y}, {self.yaw}): must be finite")
        if self.failsafe < 0:
            raise ValueError(f"failsafe={self.failsafe:g} s: must be 0 or above")
        if self.camera.lag:
            raise ValueError("camera.lag: a live camera has none here; use camera.latency")
