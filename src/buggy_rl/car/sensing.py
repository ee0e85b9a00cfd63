"""Filters of the measured velocity, as they stood in the task that a policy was trained on."""

from collections import deque
from typing import Any, Mapping, Sequence, Tuple

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
        """It remembers nothing."""

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
