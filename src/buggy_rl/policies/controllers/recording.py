"""Recording drives in a room: its options, and the drive itself."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl import keys
from buggy_rl.recordings.camera import CameraConfig
from buggy_rl.stepping import trajectory

if TYPE_CHECKING:
    from buggy_rl.policies.controllers.room import RoomDriver


@dataclass(frozen=True)
class RoomConfig:
    """The room and what the driver believes of the car; cautious, so that any engine stays in."""

    size: float = 8.0
    """Side of the square room, centred on the world's origin [m]."""
    clearance: float = 0.3
    """Kept between the tracking sensor and a wall [m]."""
    turning_radius: float = 0.75
    """Of a slow turn at 80 % of the lock [m]."""
    lateral_acceleration: float = 5.5
    """That a fast turn reaches [m/s^2]."""
    reaction: float = 0.2
    """From seeing to the car's answer [s]."""
    drive_at_rest: float = 0.22
    """Drive in 0..1 that just moves the car."""
    drive_per_speed: float = 0.1
    """Further drive for each m/s to be held [s/m]."""
    thumb_rate: float = 25.0
    """Fastest change of a command [1/s]."""


@dataclass(frozen=True)
class RecordConfig:
    """Drives in the room, as recordings."""

    output: str
    """Folder for the recordings."""
    simulator: str = "reference"
    """What is driven: an engine's name, a .yaml, a .pt, or file.py:factory."""
    drives: int = 6
    """Number of recordings."""
    seconds: float = 40.0
    """Length of each [s]."""
    seed: int = 0
    """Of the starts, the driver and the camera's noise."""
    format: str = "csv"
    """csv or parquet."""
    prefix: str = "drive"
    """Files are named prefix_00, prefix_01, ..."""
    faults: dict[str, dict[str, float]] = field(default_factory=dict)
    """What is wrong with a reference car, as faults.EFFECT.PARAMETER=VALUE."""
    sealed: str = ""
    """Folder for this config instead of OUTPUT, when the drives must not tell what is wrong."""
    camera: CameraConfig = field(default_factory=CameraConfig)
    room: RoomConfig = field(default_factory=RoomConfig)

    def __post_init__(self) -> None:
        if self.format not in ("csv", "parquet"):
            raise ValueError(f"format is {self.format!r}: must be csv or parquet")
        if self.drives < 1 or self.seconds <= 0:
            raise ValueError(f"{self.drives} drives of {self.seconds} s: both must be positive")


def driven(engine: EnvBase, driver: "RoomDriver", steps: int) -> Iterator[TensorDictBase]:
    """Rows [*] of true `pose`, `velocity` and `action`: all cars drive off from rest."""
    pose = driver.start_pose(engine.batch_size)
    start = {keys.POSE: pose, keys.VELOCITY: torch.zeros_like(pose)}
    state = engine.reset(TensorDict(start, engine.batch_size))
    for moving, _ in pairwise(trajectory(engine, state, lambda _, now: driver(now), steps)):
        yield moving.select(keys.POSE, keys.VELOCITY, keys.ACTION).clone()
