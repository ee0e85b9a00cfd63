"""A person's commands, as the command line configures them; the driver itself is the car's."""

from dataclasses import dataclass
from typing import Protocol

from buggy_rl.car.human import check_human
from buggy_rl.car.interfaces import Command


@dataclass(frozen=True)
class HumanConfig:
    """How keys and sticks become commands."""

    silence: float = 0.08
    """After so long without a message the command is neutral [s]; a step later it is applied."""
    top_throttle: float = 0.0
    """Throttle that the forward key goes to, in (-1, 1]; 0 is half of the drive."""
    throttle_rise: float = 1.0
    """Of the forward key [1/s]; from no drive to half takes 1 s."""
    throttle_fall: float = 4.0
    """After it was released [1/s]."""
    lock: float = 1.0
    """Steering that a steering key goes to, in (0, 1]."""
    steering_rise: float = 4.0
    """Of a steering key [1/s]."""
    steering_fall: float = 8.0
    """Back towards the middle [1/s]."""
    dead_zone: float = 0.08
    """Of a stick about its middle."""
    two_way: bool = False
    """For a car with brakes and reverse: no drive is throttle 0, not -1."""

    def __post_init__(self) -> None:
        check_human(self)


class Input(Protocol):
    """What a loop asks once a step."""

    def command(self, dt: float) -> Command:
        """The command for the step that begins now and lasts `dt` [s]."""
        ...
