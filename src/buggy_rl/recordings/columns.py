"""The column map: how a table that was not written for this project is to be read."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml

from buggy_rl.recordings.limits import Limits

CHANNELS = (
    *("t", "x", "y", "yaw", "qw", "qx", "qy", "qz"),
    *("vx", "vy", "yaw_rate", "throttle", "steering"),
)
"""What a drive can have, by the names of the standard table."""

UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": 0.017453292519943295},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6},
    "rate": {"rad/s": 1.0, "deg/s": 0.017453292519943295},
}
"""Factors to SI."""

QUANTITY = {
    **{"t": "t", "x": "length", "y": "length", "yaw": "angle"},
    **{"vx": "speed", "vy": "speed", "yaw_rate": "rate"},
}
"""Which channels have a unit, and the table it stands in."""


@dataclass(frozen=True)
class Throttle:
    """Raw throttle: `rest` becomes -1, `full` becomes +1, what lies beyond rest is clipped."""

    rest: float = -1.0
    """Raw value without drive."""
    full: float = 1.0
    """Raw value at full drive."""
    lowest: float | None = None
    """Raw value at the far end of brake or reverse; None when the range ends at `rest`."""
    factor: str | None = None
    """Column that multiplies what lies above rest, e.g. a dead man's switch of 0 or 1."""


@dataclass(frozen=True)
class Steering:
    """Raw steering: `right` becomes -1, `centre` 0, `left` +1, linear in between."""

    right: float = -1.0
    left: float = 1.0
    centre: float | None = None
    """None: half way."""


@dataclass(frozen=True)
class DropLeading:
    """Rows at the start, while `column` equals `equals`: a logger that waits for its sensors."""

    column: str | None = None
    equals: float = 0.0


@dataclass(frozen=True)
class Mount:
    """Where the tracker sits: its place in the body frame, and how far its yaw reads too much.

    yaw = measured - mount.yaw,  position = measured - R(yaw) (mount.x, mount.y).
    """

    x: float = 0.0
    """Ahead of the reference point [m]."""
    y: float = 0.0
    """To the left of it [m]."""
    yaw: float = 0.0
    """[rad] Positive when the tracker is turned to the left of the car."""


@dataclass(frozen=True)
class Topics:
    """Topics of a bag; None takes the only one of a fitting type."""

    odometry: str | None = None
    action: str | None = None
    action_fields: list[str] = field(default_factory=list)
    """Throttle and steering in the message, e.g. `["axes[1]", "axes[0]"]`."""


@dataclass(frozen=True)
class ColumnMap:
    """What differs from the standard table; everything has a default that means 'as it stands'."""

    names: dict[str, str] = field(default_factory=dict)
    """Channel -> column of the file."""
    units: dict[str, str] = field(default_factory=dict)
    """Channel -> unit of the file, see `UNITS`."""
    signs: dict[str, float] = field(default_factory=dict)
    """Channel -> -1 where the file counts the other way."""
    ignore: list[str] = field(default_factory=list)
    """Columns that are not to be read although their name fits."""
    throttle: Throttle = field(default_factory=Throttle)
    steering: Steering = field(default_factory=Steering)
    command_offset: float = 0.0
    """[s] Added to the stamps of the commands: -0.1 when they are stamped 0.1 s late."""
    drop_leading: DropLeading = field(default_factory=DropLeading)
    mount: Mount = field(default_factory=Mount)
    velocity_frame: Literal["body", "world"] = "body"
    derive_velocity: bool = False
    """Take the velocities from the pose even where the file has them."""
    smoothing_window: float = 0.15
    """[s] Window of the smoother that derives velocities."""
    time_from_first: bool = False
    """Let t count from the first row: for stamps of a clock that counts from 1970."""
    topics: Topics = field(default_factory=Topics)
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        for name in ("names", "units", "signs"):
            _refuse_unknown(getattr(self, name), CHANNELS, f"{name} of a column map")
        for channel, unit in self.units.items():
            known = UNITS.get(QUANTITY.get(channel, ""), {})
            _refuse_unknown([unit], tuple(known), f"unit of {channel!r}")
        for channel, sign in self.signs.items():
            if sign not in (-1, 1):
                raise ValueError(f"sign of {channel!r} is {sign}: write 1 or -1")
        if self.throttle.full == self.throttle.rest:
            raise ValueError(f"throttle: rest and full are both {self.throttle.rest}")
        if len({self.steering.left, self.steering.right}) == 1:
            raise ValueError(f"steering: left and right are both {self.steering.left}")
        if len(self.topics.action_fields) not in (0, 2):
            raise ValueError(f"action_fields needs two names, got {self.topics.action_fields}")


def load_columns(file: str | Path) -> ColumnMap:
    """Reads a column map.

    Args:
        file: YAML with the fields of `ColumnMap`; what is not written keeps its default.

    Raises:
        ValueError: A key is unknown or a value does not fit; the message names the file.
    """
    try:
        content = yaml.safe_load(Path(file).read_text())
        return _build(ColumnMap, content or {}, "the column map")
    except (ValueError, yaml.YAMLError, OSError) as error:
        raise ValueError(f"{file}: {' '.join(str(error).split())}") from error


def _build(cls: type, content: Any, place: str) -> Any:
    """A dataclass from a YAML mapping, nested ones included."""
    if not isinstance(content, Mapping):
        raise ValueError(f"{place} is {content!r}, expected keys and values")
    fields = {f.name: f for f in dataclasses.fields(cls)}
    _refuse_unknown(content, tuple(fields), place)
    values = {key: _value(fields[key].type, content[key], key) for key in content}
    return cls(**values)


def _value(kind: Any, value: Any, key: str) -> Any:
    """A YAML value checked against the type of its field."""
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _build(kind, value, key)
    choices, origin = get_args(kind), get_origin(kind)
    if origin is Literal:
        _refuse_unknown([value], choices, key)
        return value
    options: tuple[Any, ...] = (origin,) if origin in (list, dict) else choices or (kind,)
    if float in options and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, options):
        expected = " or ".join(option.__name__ for option in options)
        raise ValueError(f"{key} is {value!r}, expected {expected}")
    return value


def _refuse_unknown(names: Any, known: tuple[Any, ...], place: str) -> None:
    unknown = sorted(str(name) for name in names if name not in known)
    if unknown:
        raise ValueError(
            f"{place}: unknown {', '.join(unknown)}; available: {', '.join(map(str, known))}"
        )
