"""Recording drives in a room: its options, and the drive itself."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.car_file import load_car
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.stepping import reset_at, trajectory
from buggy_rl.core.vehicle import CONTROL_PERIOD, Similarity
from buggy_rl.policies.controllers.room import Driver, RoomConfig
from buggy_rl.recordings.camera import CameraConfig
from buggy_rl.simulators import ENGINES


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
    """Seed of the starts, the driver and the camera's noise."""
    format: str = "csv"
    """csv or parquet."""
    prefix: str = "drive"
    """Files are named prefix_00, prefix_01, ..."""
    driver: Literal["room", "manoeuvring"] = "room"
    """room: forward only; manoeuvring: also brakes and reverses, of a car whose command can."""
    car: str = ""
    """The car: a name in configs/cars or a file of one's own; empty for the buggy. Room, speeds and
    the driver's times are scaled to it, and an engine of ours is made that car; the camera is
    not."""
    options: dict[str, Any] = field(default_factory=dict)
    """Further arguments of the engine, e.g. options.command=throttle_brake_reverse."""
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

    @property
    def similarity(self) -> Similarity:
        """Ratios of the car to the buggy."""
        car = self.car or str(self.options.get("car", ""))
        return load_car(car).similarity if car else Similarity()

    @property
    def of_engine(self) -> dict[str, Any]:
        """Arguments of the engine; a simulator's file says itself which car it is."""
        named = {"car": self.car} if self.car and self.simulator in ENGINES else {}
        return named | self.options | ({"faults": self.faults} if self.faults else {})


def make_driver(config: RecordConfig, engine: EnvBase) -> Driver:
    """The driver of a config for the cars of an engine.

    Raises:
        ValueError: It cannot drive a car with this command.
    """
    from buggy_rl.policies.controllers.at_scale import ManoeuvringDriver, RoomAtScale
    from buggy_rl.policies.controllers.room import RoomDriver

    command, scale = declared_by(engine), config.similarity
    dt = CONTROL_PERIOD / scale.time
    if config.driver == "manoeuvring":
        values = getattr(engine, "values", {})
        full_speed = float(values["full_speed"].mean()) if "full_speed" in values else 5.0
        full_speed /= scale.speed
        driver = ManoeuvringDriver(config.room, config.seed, command, full_speed, dt)
        return driver if scale == Similarity() else RoomAtScale(driver, scale)
    if command.kind != "throttle":
        raise ValueError(
            f"driver=room drives a one-way throttle, {config.simulator} takes {command}: "
            "driver=manoeuvring"
        )
    driver = RoomDriver(config.room, config.seed, dt)
    return driver if scale == Similarity() else RoomAtScale(driver, scale)


def recorded_steps(engine: EnvBase, driver: Driver, steps: int) -> Iterator[TensorDictBase]:
    """Rows [*] of true `pose`, `velocity` and `action`: all cars drive off from rest."""
    pose = driver.start_pose(engine.batch_size)
    start = {keys.POSE: pose, keys.VELOCITY: torch.zeros_like(pose)}
    state = reset_at(engine, TensorDict(start, engine.batch_size))
    for moving, _ in pairwise(trajectory(engine, state, lambda _, now: driver(now), steps)):
        yield moving.select(keys.POSE, keys.VELOCITY, keys.ACTION).clone()
