"""An edit: what makes a recording of a car that of the same car with an effect.

A car P driven by u gave y. An effect on the commands, u = E(u'), has a log u' such that P with the
effect, driven by u', gives exactly y; an effect of the sensor gives y' = S(y). Edits compute u' and
y' by formulas of their own: nothing of `buggy_rl.effects` is used.
"""

import random
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import torch
from numpy import ndarray

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import command_of, drive_of
from buggy_rl.recordings import Recording

VARIES = 0.05  # [command] least standard deviation of a column that an edit of it needs; chosen
DIGITS = 4  # of a drawn number


@dataclass(frozen=True, eq=False)
class LogRows:
    """Rows of a recording without a gap."""

    t: ndarray
    """[T] time since the recording began [s]."""
    pose: ndarray
    """[T, 3] x, y [m], yaw [rad], not wrapped."""
    velocity: ndarray
    """[T, 3] vx, vy [m/s], yaw rate [rad/s]."""
    throttle: ndarray
    """[T] first command, in -1..1."""
    steering: ndarray
    """[T] second command, in -1..1."""
    rest: float
    """First command without drive."""
    dt: float
    """[s]"""

    def __len__(self) -> int:
        return len(self.t)

    @property
    def drive(self) -> ndarray:
        """[T] drive of the first command, 0 at rest; below 0 it brakes or reverses."""
        return drive_of(self.throttle, self.rest)

    def with_drive(self, driven: ndarray) -> "LogRows":
        """Rows with another drive where there is any; without drive, or below, it stays."""
        return replace(
            self, throttle=np.where(self.drive > 0, command_of(driven, self.rest), self.throttle)
        )

    def between(self, first: int, last: int) -> "LogRows":
        """Rows from `first` up to but without `last`."""
        columns = {n: v[first:last] for n, v in vars(self).items() if isinstance(v, np.ndarray)}
        return replace(self, **columns)


class Edit(ABC):
    """One edit, named after the effect of the library that it is an instance of, if any."""

    name: ClassVar[str]
    mechanism: ClassVar[str]
    """What it is of; the two edits of a pair differ in it."""
    varies: ClassVar[str] = ""
    """Column of the commands that must vary in a recording; empty where none has to."""
    known: ClassVar[bool] = True
    """Whether the library has an effect of this name, with these parameters."""
    speed_too: ClassVar[bool] = True
    """Whether it makes sense of a car whose first command is a speed."""

    @abstractmethod
    def drawn(self, chance: random.Random) -> dict[str, float]:
        """Parameters, from below what can be found to severe."""

    @abstractmethod
    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        """Rows of the car that has the effect; those at an end that would need more are cut."""


def log_rows(recording: Recording) -> Iterator[LogRows]:
    """The parts of a recording between its gaps."""
    data = recording.data
    numbers = {key: data[key].double().numpy() for key in (keys.POSE, keys.VELOCITY, keys.ACTION)}
    t, segment = data[keys.TIME][:, 0].numpy(), data[keys.SEGMENT].numpy()
    for number in np.unique(segment):
        own = segment == number
        yield LogRows(
            t=t[own] - t[0],
            pose=numbers[keys.POSE][own],
            velocity=numbers[keys.VELOCITY][own],
            throttle=numbers[keys.ACTION][own, 0],
            steering=numbers[keys.ACTION][own, 1],
            rest=recording.command.rest,
            dt=recording.dt,
        )


def command_spread(recording: Recording, column: str) -> float:
    """Standard deviation of a column of the commands."""
    number = ("throttle", "steering").index(column)
    return float(recording.data[keys.ACTION][:, number].std())


def log_uniform(chance: random.Random, low: float, high: float) -> float:
    """A number between two of one sign, its logarithm uniform."""
    return float(np.exp(chance.uniform(np.log(low), np.log(high))))


def signed(chance: random.Random, size: float) -> float:
    """A size to either side, as many digits of it as are sealed."""
    return round(chance.choice((-1, 1)) * size, DIGITS)


def ratio(chance: random.Random, low: float, high: float) -> float:
    """A factor or its inverse, exp(+-x) of a log-uniform x."""
    return round(float(np.exp(signed(chance, log_uniform(chance, low, high)))), DIGITS)


def whole_rows(chance: random.Random, low: int, high: int, dt: float) -> float:
    """A time of whole rows [s], log-uniform."""
    return round(round(log_uniform(chance, low, high)) * dt, DIGITS)


def to_tensor(columns: ndarray) -> torch.Tensor:
    """Numbers as a recording holds them."""
    return torch.as_tensor(columns).float()
