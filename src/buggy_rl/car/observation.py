"""The observation of a policy, its past numbers, and the filters of the measured velocity."""

from collections import deque
from typing import Any, Callable, Dict, List, Mapping, Sequence, Tuple

import numpy as np

Quantities = Tuple[Tuple[str, str], ...]
"""Name and unit of each number."""

COMMAND_PAIR = (("throttle", "-1..1"), ("steering", "-1..1"))
INPUTS: Dict[str, Quantities] = {  # what an observation may consist of, beside the waypoints
    "velocity": (("vx", "m/s"), ("vy", "m/s"), ("yaw_rate", "rad/s")),
    "measured_velocity": (("vx", "m/s"), ("vy", "m/s"), ("yaw_rate", "rad/s")),
    "last_action": tuple(("last_" + name, unit) for name, unit in COMMAND_PAIR),
    "smoothed_action": tuple(("smoothed_" + name, unit) for name, unit in COMMAND_PAIR),
    "limited_action": tuple(("limited_" + name, unit) for name, unit in COMMAND_PAIR),
    "target_speed": (("target_speed", "m/s"),),
    "lateral_error": (("lateral_error", "m"),),
    "heading_error": (("heading_error", "rad"),),
}


def quantities(inputs: Sequence[str], visible: int) -> Quantities:
    """Name and unit of every number of an observation made of `inputs`, in their order."""
    points = [(f"{axis}_{i + 1}", "m") for i in range(visible) for axis in "xy"]
    every = dict(INPUTS, waypoints=tuple(points))
    return tuple(quantity for key in inputs for quantity in every[key])


class Observation:
    """One row of numbers, or the last `rows` of them side by side, oldest first.

    Args:
        inputs: Keys in their order.
        rows: Observations, the present one included.
        visible: Waypoints shown.
    """

    def __init__(self, inputs: Sequence[str], rows: int, visible: int) -> None:
        size = len(quantities(inputs, visible))
        self._rows = np.zeros((rows, size), np.float32)
        self._row = self._rows[-1]
        self._begun = False
        self.values = self._rows.reshape(-1)
        """[rows * size] float32: what the network is given."""
        self.waypoints = np.zeros((visible, 2), np.float32)
        """[visible, 2] where the waypoints are to be written: a part of the present row."""
        self._places: List[Tuple[str, int, int]] = []
        first = 0
        for key in inputs:
            last = first + (2 * visible if key == "waypoints" else len(INPUTS[key]))
            if key == "waypoints":
                self.waypoints = self._row[first:last].reshape(visible, 2)
            else:
                self._places.append((key, first, last))
            first = last

    def reset(self) -> None:
        """The next row is the first: it stands for those before it too."""
        self._begun = False

    def advance(self) -> None:
        """Makes the present row the last one; call it before writing."""
        if len(self._rows) > 1 and self._begun:
            self._rows[:-1] = self._rows[1:]

    def write(self, value: Callable[[str], Sequence[float]]) -> None:
        """Fills the present row, whose waypoints are already there, with `value(key)`."""
        row = self._row
        for key, first, last in self._places:
            row[first:last] = value(key)
        if not self._begun:
            self._rows[:] = row
            self._begun = True


Velocity = Tuple[float, float, float]
"""vx, vy [m/s], yaw_rate [rad/s] in the body frame."""


class PastMean:
    """The mean of the last `width` velocities; at the start of those that there are."""

    def __init__(self, width: int) -> None:
        self._rows = tuple(deque(maxlen=width) for _ in range(3))

    def reset(self) -> None:
        """Forgets all velocities."""
        for row in self._rows:
            row.clear()

    def filtered(self, velocity: Velocity) -> Velocity:
        """The mean with this velocity included."""
        vx, vy, yaw_rate = self._rows
        for row, value in zip(self._rows, velocity):
            row.append(value)
        count = len(vx)
        return sum(vx) / count, sum(vy) / count, sum(yaw_rate) / count


class ClipVelocity:
    """Velocities cut off at the range that the policy was trained in."""

    def __init__(self, low: Sequence[float], high: Sequence[float]) -> None:
        self._low, self._high = tuple(low), tuple(high)

    def reset(self) -> None:
        """Does nothing: the filter remembers nothing."""

    def filtered(self, velocity: Velocity) -> Velocity:
        """Each of the three within its bounds; NaN stays NaN."""
        (vx, vy, yaw_rate), low, high = velocity, self._low, self._high
        return (
            min(max(vx, low[0]), high[0]),
            min(max(vy, low[1]), high[1]),
            min(max(yaw_rate, low[2]), high[2]),
        )


SENSING = {"past_mean": PastMean, "clip_velocity": ClipVelocity}


def make_sensing(about: Mapping[str, Any]) -> Any:
    """The filter that an entry of a policy's JSON names."""
    options = {key: value for key, value in about.items() if key != "name"}
    return SENSING[about["name"]](**options)
