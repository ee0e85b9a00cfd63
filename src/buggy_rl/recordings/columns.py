"""The column map: how a table with other columns, units or signs is read."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import yaml
from omegaconf import MISSING

from buggy_rl.core.config import config_file, from_plain
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.recordings.recording import Limits

CHANNELS = (
    *("t", "x", "y", "yaw", "qw", "qx", "qy", "qz"),
    *("vx", "vy", "yaw_rate", "throttle", "steering"),
)
"""Channels of a recording, by their columns in the standard table."""
QUATERNION = "qw", "qx", "qy", "qz"
"""Channels of an orientation, w first."""
BESIDE = "wheel_speed", "gyro"
"""Channels of sensors beside the tracker, by their keys; a recording may have them."""
COMMANDS = "throttle", "steering", "throttle factor"
"""Channels that hold their value until the next one; a factor belongs to the throttle."""

DEGREE = math.pi / 180  # [rad]
UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": DEGREE},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6},
    "rate": {"rad/s": 1.0, "deg/s": DEGREE},
}
"""Factors to SI, by quantity and unit."""

QUANTITY = {
    **{"t": "t", "x": "length", "y": "length", "yaw": "angle"},
    **{"vx": "speed", "vy": "speed", "yaw_rate": "rate"},
    **{"wheel_speed": "speed", "gyro": "rate"},
}
"""Quantity of each channel that has a unit."""


@dataclass(frozen=True)
class Throttle:
    """Raw throttle: `rest` maps to -1, `full` to +1; values below rest are clipped to -1.

    With a command that has reverse `lowest` maps to -1, `rest` to 0 and `full` to +1, linear on
    either side; left out altogether it is read as -1, 0 and +1.
    """

    rest: float = -1.0
    """Raw value without drive."""
    full: float = 1.0
    """Raw value at full drive."""
    lowest: float | None = None
    """Raw value at full brake or reverse; None where the range ends at `rest`, or with reverse
    where it is as far from rest as `full`."""
    factor: str | None = None
    """Column that multiplies the drive above rest, e.g. a dead man's switch of 0 or 1."""


@dataclass(frozen=True)
class SteeringRange:
    """Raw steering: `right` maps to -1, `centre` to 0, `left` to +1, linear in between."""

    right: float = -1.0
    left: float = 1.0
    centre: float | None = None
    """None: the mean of left and right."""
    deadband: float = 0.0
    """Raw values this near to the centre turn no wheel: they map to 0, and the map is linear from
    the edge of this dead zone to full lock."""

    @property
    def middle(self) -> float:
        """Raw value at the centre."""
        return (self.left + self.right) / 2 if self.centre is None else self.centre


@dataclass(frozen=True)
class DropLeading:
    """Leading rows in which `column` equals `equals`, e.g. before the sensors are ready."""

    column: str | None = None
    equals: float = 0.0


@dataclass(frozen=True)
class TrackerMount:
    """Pose of the tracker in the body frame.

    yaw = measured - mount.yaw,  position = measured - R(yaw) (mount.x, mount.y).
    """

    x: float = 0.0
    """Ahead of the reference point [m]."""
    y: float = 0.0
    """Position of the tracker to the left of the reference point [m]."""
    yaw: float = 0.0
    """Rotation of the tracker to the left of the car [rad]."""


@dataclass(frozen=True)
class SourceTable:
    """One of several tables of a drive."""

    file: str = MISSING
    """File of the table in the folder of the drive, e.g. `pose.csv`; names then read `pose.x`."""
    time: dict[str, str] = field(default_factory=dict)
    """Columns of the stamp and their units, which add up: `{sec: s, nanosec: ns}`."""


@dataclass(frozen=True)
class Topics:
    """Topics of a bag; None selects the only topic of a suitable type."""

    odometry: str | None = None
    """Pose: odometry, or a pose or transform of motion capture."""
    action: str | None = None
    action_fields: list[str] = field(default_factory=list)
    """Throttle and steering in the message, e.g. `["axes[1]", "axes[0]"]`; with a topic for each
    `["/commands/motor/speed:data", "/commands/servo/position:data"]`."""
    odometry_source: str | None = None
    """Node or frame whose messages are read, where several publish the topic of the pose."""
    action_source: str | None = None
    """The same of the commands."""


@dataclass(frozen=True)
class ColumnMap:
    """Differences from the standard table; the defaults are the standard table."""

    names: dict[str, str] = field(default_factory=dict)
    """Channel -> column of the file."""
    units: dict[str, str] = field(default_factory=dict)
    """Channel -> unit of the file, one of `UNITS`."""
    signs: dict[str, float] = field(default_factory=dict)
    """Channel -> -1 where the file has the opposite sign."""
    ignore: list[str] = field(default_factory=list)
    """Columns that are not read although their name is that of a channel."""
    command: LongitudinalCommand = field(default_factory=LongitudinalCommand)
    """What the first command is; that of the car's file where the map does not say."""
    throttle: Throttle = field(default_factory=Throttle)
    steering: SteeringRange = field(default_factory=SteeringRange)
    command_offset: float = 0.0
    """[s] Added to the stamps of the commands: -0.1 when they are stamped 0.1 s late."""
    drop_leading: DropLeading = field(default_factory=DropLeading)
    mount: TrackerMount = field(default_factory=TrackerMount)
    velocity_frame: Literal["body", "world"] = "body"
    derive_velocity: bool = False
    """Derive the velocities from the pose even where the file has them."""
    smoothing_window: float = 0.15
    """[s] Window of the Savitzky-Golay filter that derives velocities."""
    time_from_first: bool = False
    """Count t from the first row, e.g. for stamps that count from 1970."""
    rate: float | None = None
    """[Hz] The rows come evenly at it, whatever their stamps: of a file without stamps, or with
    stamps in whole seconds."""
    topics: Topics = field(default_factory=Topics)
    tables: list[SourceTable] = field(default_factory=list)
    """Tables of a drive that is a folder of several; rows are those of the first."""
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        for name in ("names", "units", "signs"):
            _refuse_unknown(getattr(self, name), (*CHANNELS, *BESIDE), name)
        for channel, unit in self.units.items():
            known = UNITS.get(QUANTITY.get(channel, ""), {})
            _refuse_unknown([unit], known, f"unit of {channel}")
        for table in self.tables:
            _refuse_unknown(table.time.values(), UNITS["t"], f"tables: time of {table.file}")
            if not table.time:
                raise ValueError(f"tables: {table.file} has no time; write time: {{column: s}}")
        if self.rate is not None and self.rate <= 0:
            raise ValueError(f"rate is {self.rate} Hz; write one above 0")
        for channel, sign in self.signs.items():
            if sign not in (-1, 1):
                raise ValueError(f"signs: {channel} is {sign}; write 1 or -1")
        if self.command.two_way:
            object.__setattr__(self, "throttle", _both_ways(self.throttle))
        if self.throttle.full == self.throttle.rest:
            raise ValueError(
                f"throttle: rest and full are both {self.throttle.rest}; they must differ"
            )
        if len({self.steering.left, self.steering.right}) == 1:
            raise ValueError(
                f"steering: left and right are both {self.steering.left}; they must differ"
            )
        reach = min(
            abs(end - self.steering.middle) for end in (self.steering.left, self.steering.right)
        )
        if not 0 <= self.steering.deadband < reach:
            raise ValueError(
                f"steering: deadband is {self.steering.deadband}; must be at least 0 and below "
                f"{reach:g}, the raw value from the centre to the nearer lock"
            )
        if len(self.topics.action_fields) not in (0, 2):
            raise ValueError(f"action_fields is {self.topics.action_fields}; needs two names")


def load_columns(file: str | Path) -> ColumnMap:
    """Reads YAML with the fields of `ColumnMap`; an absent field keeps its default.

    Raises:
        ValueError: A key is unknown or a value is invalid; the message names the file.
    """
    try:
        content = yaml.safe_load(config_file(file).read_text()) or {}
        if not isinstance(content, Mapping):
            raise ValueError(f"it is {content!r}, expected keys and values")
        return from_plain(ColumnMap, _named(content), "column map")
    except (ValueError, yaml.YAMLError, OSError) as error:
        raise ValueError(f"{file}: {' '.join(str(error).split())}") from error


def _named(content: Any) -> Any:
    """YAML with keys as text: columns of a table without a header are numbers."""
    if isinstance(content, Mapping):
        return {str(key): _named(value) for key, value in content.items()}
    return [_named(value) for value in content] if isinstance(content, list) else content


def _both_ways(throttle: Throttle) -> Throttle:
    """The range of a throttle with reverse, complete.

    Raises:
        ValueError: Lowest and full are on the same side of rest.
    """
    if throttle == Throttle():
        return Throttle(rest=0.0, full=1.0, lowest=-1.0)
    rest, full, lowest = throttle.rest, throttle.full, throttle.lowest
    if lowest is None:
        return replace(throttle, lowest=2 * rest - full)
    if (lowest - rest) * (full - rest) >= 0:
        raise ValueError(
            f"throttle: lowest is {lowest} and full {full}: of a command with reverse they are on "
            f"either side of rest, {rest}"
        )
    return throttle


def _refuse_unknown(names: Iterable[str], known: Iterable[str], place: str) -> None:
    unknown = sorted(name for name in names if name not in known)
    if unknown:
        raise ValueError(f"{place}: unknown {', '.join(unknown)}; available: {', '.join(known)}")
