"""A car's file: dimensions, drive, steering, limits, command and sensor of one kind of car.

`car=f1tenth` names a file in `configs/cars`, `car=my_car.yaml` one's own. What a file leaves out is
that of a buggy scaled to its mass and wheelbase (`similarity`), and said to be assumed.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal

from buggy_rl.core.config import CONFIGS, ConfigError, from_plain
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.core.vehicle import Similarity, VehicleDimensions, similar_dimensions

PRESETS = CONFIGS / "cars"
BUGGY_SPEED = 10.0  # [m/s] top speed that the buggy is driven at; the original study's car
STEEPNESS = 1.1  # [-] of the steering map where only full lock is known; that of the buggy
FRONT_SHARE = {"rear": 0.0, "front": 1.0, "all": 0.5}
"""Drive -> share of the wheel force at the front axle."""

Drive = Literal["rear", "front", "all"]
SensorKind = Literal["tracking_camera", "motion_capture", "lidar", "gps"]


@dataclass(frozen=True)
class SteeringGeometry:
    """Road-wheel angles at full command; None where they are not known."""

    left: float | None = None
    """Angle at +1, to the left [rad], positive."""
    right: float | None = None
    """Angle at -1, to the right [rad], positive too."""


@dataclass(frozen=True)
class CarLimits:
    """What the car can do."""

    top_speed: float | None = None
    """Fastest that it drives [m/s]; None: the buggy's, scaled."""


@dataclass(frozen=True)
class SensorMount:
    """What sees the car, and where on it."""

    kind: SensorKind = "tracking_camera"
    ahead: float | None = None
    """Distance ahead of the centre of gravity [m], where the body frame sits. None: scaled."""
    rate: float | None = None
    """Poses a second [Hz]."""


@dataclass(frozen=True)
class CarFile:
    """One kind of car."""

    name: str
    about: str = ""
    """One line: what it is."""
    dimensions: dict[str, float] = field(default_factory=dict)
    """Dimensions of `vehicle.VehicleDimensions` that are known; mass and wheelbase are needed."""
    drive: Drive = "rear"
    """Driven axle: rear, front or all."""
    steering: SteeringGeometry = field(default_factory=SteeringGeometry)
    limits: CarLimits = field(default_factory=CarLimits)
    command: LongitudinalCommand = field(default_factory=LongitudinalCommand)
    """What the first command is."""
    sensor: SensorMount = field(default_factory=SensorMount)

    def __post_init__(self) -> None:
        missing = sorted({"mass", "wheelbase"} - set(self.dimensions))
        if missing:
            raise ConfigError(f"car {self.name}: dimensions: needed but not given: {missing}")
        for name, value in (*self.dimensions.items(), *self._numbers()):
            if name not in ("sensor_to_cg", "sensor.ahead") and not value > 0:
                raise ConfigError(f"car {self.name}: {name} is {value}: must be above 0")
        if self.command.kind == "speed" and self.command.full_speed is None:
            raise ConfigError(f"car {self.name}: a speed command needs command.full_speed [m/s]")

    def _numbers(self) -> list[tuple[str, float]]:
        numbers = {
            "steering.left": self.steering.left,
            "steering.right": self.steering.right,
            "limits.top_speed": self.limits.top_speed,
            "command.full_speed": self.command.full_speed,
            "sensor.rate": self.sensor.rate,
        }
        return [(name, value) for name, value in numbers.items() if value is not None]

    @property
    def vehicle(self) -> VehicleDimensions:
        """All dimensions; those that are not known are a scaled buggy's."""
        known = dict(self.dimensions)
        if self.sensor.ahead is not None:
            known["sensor_to_cg"] = self.sensor.ahead
        return similar_dimensions(known)

    @property
    def top_speed(self) -> float:
        """Fastest that it drives [m/s]."""
        scaled = BUGGY_SPEED * Similarity.between(self.vehicle).speed
        return self.limits.top_speed or scaled

    @property
    def similarity(self) -> Similarity:
        """Ratios to the buggy."""
        return Similarity.between(self.vehicle, speed=self.top_speed / BUGGY_SPEED)

    @property
    def assumed(self) -> list[str]:
        """Names of what the file does not say."""
        given = set(self.dimensions) | (
            {"sensor_to_cg"} if self.sensor.ahead is not None else set()
        )
        names = [f.name for f in fields(VehicleDimensions) if f.name not in given]
        return names + ([] if self.limits.top_speed else ["top_speed"])

    def of_engine(self, engine: str) -> dict[str, dict[str, Any]]:
        """`options` and `parameters` that make an engine this car.

        Args:
            engine: single_track, kinematic, mujoco or reference.

        Raises:
            ValueError: The engine cannot drive these wheels, or take this command.
        """
        options: dict[str, Any] = {
            "dimensions": asdict(self.vehicle),
            "speed_ratio": self.similarity.speed,
        }
        if self.command.plain != "throttle":
            options["command"] = self.command.plain
        if engine == "reference" and self.drive != "rear":
            raise ValueError(
                f"engine reference has rear-wheel drive, car {self.name} drives {self.drive}: "
                "mujoco and single_track can"
            )
        if engine == "mujoco" and self.drive != "rear":
            options["drive"] = self.drive
        return {"options": options, "parameters": self._parameters(engine)}

    def _parameters(self, engine: str) -> dict[str, float]:
        locks = {"left": self.steering.left, "right": self.steering.right}
        known = {side: angle for side, angle in locks.items() if angle is not None}
        if engine == "mujoco":
            return {f"steering_{side}": angle for side, angle in known.items()} | self._setpoint()
        if engine == "reference":  # its brakes are discs, whatever drives
            return {f"lock_{side}": angle for side, angle in known.items()} | self._setpoint()
        # Full lock is angle * tanh(steepness): `road_wheel_angle` of the bicycle engines.
        angles = {f"{side}_angle": angle / math.tanh(STEEPNESS) for side, angle in known.items()}
        steepness = {f"{side}_steepness": STEEPNESS for side in known}
        own = {"front_drive_share": FRONT_SHARE[self.drive]} if engine == "single_track" else {}
        if self.command.kind == "throttle_brake_reverse":  # the motor brakes what it drives
            own["brake_front_share"] = FRONT_SHARE[self.drive]
        return angles | steepness | own | self._setpoint()

    def _setpoint(self) -> dict[str, float]:
        full_speed = self.command.full_speed
        return {} if full_speed is None else {"full_speed": full_speed}


def load_car(car: str) -> CarFile:
    """Reads a car by its name in `configs/cars`, or one's own `.yaml` file.

    Raises:
        ConfigError: There is none, or it is not a car's file; the message names the file.
    """
    import yaml

    file = Path(car) if car.endswith((".yaml", ".yml")) else PRESETS / f"{car}.yaml"
    if not file.is_file():
        known = ", ".join(sorted(path.stem for path in PRESETS.glob("*.yaml")))
        raise ConfigError(f"there is no car {car!r}; available: {known}, or a .yaml of your own")
    try:
        content = yaml.safe_load(file.read_text())
    except yaml.YAMLError as error:
        raise ConfigError(f"{file} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, Mapping):
        raise ConfigError(f"{file}: it is {content!r}, expected keys and values")
    return from_plain(CarFile, {"name": file.stem, **content}, str(file))
