"""What the first of the two commands is: a throttle, brake and reverse, a speed, or a current.

A command u is in [-1, 1] whatever it is. One-way commands have no reverse: u = -1 is no drive, and
drive = (u + 1) / 2 is in 0..1. Two-way commands are at rest at u = 0, and drive = u is in -1..1.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, Self, TypeVar, get_args

Kind = Literal["throttle", "throttle_brake_reverse", "speed", "current"]
Number = TypeVar("Number")

ONE_WAY_REST = -1.0  # [-] command without drive of a throttle that cannot reverse
TWO_WAY_REST = 0.0  # [-] command without drive of one that can


@dataclass(frozen=True)
class LongitudinalCommand:
    """Kind of the first command, as a column map and a car's file declare it.

    Raises:
        ValueError: The kind is unknown, or a field does not belong to it.
    """

    kind: Kind = "throttle"
    """`throttle`: drive of the motor, no reverse. `throttle_brake_reverse`: a two-way speed
    controller (ESC): above 0 it drives, below 0 it brakes a car that rolls forward and reverses one
    that stands. `speed`: a setpoint that a controller follows. `current`: a signed motor force."""
    full_speed: float | None = None
    """Setpoint of a full `speed` command [m/s]."""
    reverse: bool = False
    """Whether the setpoint of a `speed` command may be negative."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            known = ", ".join(get_args(Kind))
            raise ValueError(f"command is {self.kind!r}: must be one of {known}")
        if self.reverse and self.kind == "throttle":
            raise ValueError(
                "command: a throttle has no reverse: write kind: throttle_brake_reverse"
            )
        if self.full_speed is not None and self.kind != "speed":
            raise ValueError(
                f"command: full_speed is {self.full_speed} of kind {self.kind}: only a speed "
                "command has a full_speed, leave it out"
            )

    @classmethod
    def of(cls, command: "str | Mapping[str, Any] | LongitudinalCommand") -> Self:
        """Makes a command from a kind's name or a mapping of the fields, as options have it.

        Raises:
            ValueError: It is none.
        """
        if isinstance(command, cls):
            return command
        if isinstance(command, str):
            return cls(command)  # type: ignore[arg-type]  # checked above
        try:
            return cls(**command)  # type: ignore[arg-type]
        except TypeError as error:
            raise ValueError(f"command is {command!r}: {error}") from None

    @property
    def two_way(self) -> bool:
        """Whether it can make the car reverse."""
        return self.kind in ("throttle_brake_reverse", "current") or self.reverse

    @property
    def rest(self) -> float:
        """Command without drive."""
        return TWO_WAY_REST if self.two_way else ONE_WAY_REST

    @property
    def plain(self) -> str | dict[str, Any]:
        """What `of` takes, without `full_speed`, which is a simulator's parameter."""
        return {"kind": self.kind, "reverse": True} if self.reverse else self.kind

    @property
    def plain_fields(self) -> dict[str, Any]:
        """The fields that are not at their default, as a file has them."""
        return {"kind": self.kind} | ({"reverse": True} if self.reverse else {})

    def __str__(self) -> str:
        return f"{self.kind} with reverse" if self.reverse else self.kind


ONE_WAY = LongitudinalCommand()
"""The original car's throttle."""


def drive_of(command: Number, rest: float) -> Number:
    """Drive of a command: (u + 1) / 2 in 0..1 where -1 is at rest, u in -1..1 where 0 is."""
    return 0.5 * (command + 1) if rest == ONE_WAY_REST else command  # type: ignore[operator]


def command_of(drive: Number, rest: float) -> Number:
    """The inverse of `drive_of`."""
    return 2 * drive - 1 if rest == ONE_WAY_REST else drive  # type: ignore[operator]


def declared_by(simulator: Any) -> LongitudinalCommand:
    """The command that a simulator takes; a one-way throttle where it has no `command` to say."""
    command = getattr(simulator, "command", None)
    return command if isinstance(command, LongitudinalCommand) else ONE_WAY
