"""Common form of the unknown effects."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, sum4


class Unknown:
    """One physical effect; an instance holds its size and constants and never changes.

    All memory of an effect is in the state under keys that begin with its name. An effect alters
    the "inputs" of an integration step (see RallyCar._inputs) before it is taken and advances
    its own memory afterwards from the "signals" of the step.
    """

    name = ""
    low = 0.0
    high = 1.0
    mechanism = ""

    def __init__(self, size: Array, k: Arrays) -> None:
        """Keeps size [N], in the unit of the effect, and constants k of the cars."""
        self.size, self.wide, self.k = size, col(size), k
        self.cars = len(size)
        self.active = size > 0.0

    def key(self, part: str) -> str:
        """Name of a part of this effect's memory in the state."""
        return f"{self.name}.{part}"

    def hidden(self, index: int) -> Array:
        """A constant in [0, 1) of each car [N] that places the effect."""
        return np.ascontiguousarray(self.k["hidden"][:, index])

    def start(self, state: Arrays) -> Arrays:
        """Memory at the start of a drive."""
        return {}

    def command(self, state: Arrays, command: Array) -> Array:
        """Alter the command [N, 2] of a control period."""
        return command

    def before(self, inputs: Arrays, state: Arrays, dt: float) -> None:
        """Alter the inputs of an integration step."""

    def after(self, state: Arrays, signals: Arrays, dt: float) -> None:
        """Advance the memory by one integration step."""

    def finish(self, state: Arrays) -> None:
        """Advance the memory at the end of a control period (sensors)."""

    def show(self, state: Arrays, pose: Array, velocity: Array) -> tuple[Array, Array]:
        """Alter what the sensors show, [N, 3] each."""
        return pose, velocity


def slide_power(signals: Arrays) -> Array:
    """Power lost by sliding in each contact patch, W [N, 4]."""
    lost = signals["force_x"] * signals["slip_x"] + signals["force_y"] * signals["slip_y"]
    return np.maximum(-lost, 0.0)


def driven_speed(k: Arrays, state: Arrays) -> Array:
    """Rolling speed of the driven wheels from their mean spin, m/s [N]."""
    return sum4(k["gear_share"] * state["wheel"]) / k["gear"] * k["radius"]


def wrap(angle: Array) -> Array:
    """Angle in [-pi, pi)."""
    return angle - 2.0 * np.pi * np.floor(angle / (2.0 * np.pi) + 0.5)


def hump(place: Array, half_width: Array | float) -> tuple[Array, Array]:
    """Smooth hump of height 1 at place 0, zero beyond half_width: (height, slope)."""
    part = np.minimum(np.abs(place) / half_width, 1.0)
    inner = 1.0 - part * part
    return inner * inner, -4.0 * inner * part * np.sign(place) / half_width
