"""Pure pursuit in numpy: follows a path without a trained policy, for tests and first drives."""

import math
from typing import Any, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from buggy_rl.car.interfaces import Command
from buggy_rl.car.path import Path
from buggy_rl.car.settings import section

WHEELBASE = 0.174  # [m] of the project's own car
COMPLETED = "completed the path"
STANDS = 0.3  # [m/s] speed below which it is not braked: the command would reverse it
CREEP = 0.05  # [m/s] added to the speed of a weave that would stand still


class PursuitConfig(NamedTuple):
    """Distances, speeds and gains."""

    look_ahead: float = 0.45
    """Distance to the point that is steered for [m]."""
    speed: float = 1.2
    """To hold [m/s]."""
    weave: float = 0.0
    """Share by which the speed swings about it, and the steering swings with it."""
    period: float = 3.0
    """Of the swing of the speed [s]; that of the steering is a fifth."""
    drive_at_rest: float = 0.22
    """Drive in 0..1 that just moves the car."""
    drive_per_speed: float = 0.1
    """Further drive for each m/s to be held [s/m]."""
    full_lock: float = 0.36
    """Road-wheel angle at steering 1 [rad]."""
    dt: float = 0.01
    """Control period [s]."""


RANGES = {
    "look_ahead": (0.1, 5.0),
    "speed": (0.1, 5.0),
    "weave": (0.0, 1.0),
    "period": (0.2, 60.0),
    "drive_at_rest": (0.0, 1.0),
    "drive_per_speed": (0.0, 1.0),
    "full_lock": (0.05, 1.0),
    "dt": (0.001, 0.1),
}


class Pursuit:
    """delta = atan(2 L y / (x^2 + y^2)) to the path's point (x, y) at the look-ahead distance.

    With `weave` it drives as a diagnosis needs it: fast and slow, and with a swinging wheel.

    Args:
        config: Numbers.
        two_way: Whether the car brakes and reverses: no drive is throttle 0, not -1.
    """

    def __init__(self, config: PursuitConfig, two_way: bool = False) -> None:
        self.config, self.two_way = config, two_way
        self._points = np.zeros((1, 2))
        self._closed, self._at, self._time = False, -1, 0.0
        self.control_period = config.dt
        self.ended = ""
        """Why the drive is over, at the end of an open path."""

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any], two_way: bool = False) -> "Pursuit":
        """Of its settings, those of `PursuitConfig`, for a car that may reverse."""
        return cls(section(PursuitConfig, settings, "policy", RANGES), two_way)

    def reset(self, path: Path) -> None:
        """Begins wherever on a path the car is; a closed one is followed round and round."""
        self._points, self._closed = path.points.astype(np.float64), path.closed
        self._at, self.ended = -1, ""

    def step(self, pose: Sequence[float], velocity: Sequence[float]) -> Command:
        """Throttle and steering for x, y, yaw and vx, vy, yaw_rate."""
        c = self.config
        swing = math.sin(2 * math.pi * self._time / c.period)
        fast = math.sin(10 * math.pi * self._time / c.period)
        self._time += c.dt
        x, y = self._seen(pose)
        bend = 2 * y / max(x * x + y * y, 1e-6)
        steering = math.atan(WHEELBASE * bend) / c.full_lock + 0.4 * c.weave * fast
        speed = max(CREEP, c.speed * (1 + c.weave * swing))
        drive = c.drive_at_rest + c.drive_per_speed * speed + 0.3 * (speed - velocity[0])
        return self._throttle(drive, velocity[0]), max(-1.0, min(1.0, steering))

    def _throttle(self, drive: float, speed: float) -> float:
        """Of a drive; below 0 it brakes a car that can, while that rolls."""
        if not self.two_way:
            return 2 * max(0.0, min(1.0, drive)) - 1
        return max(-1.0 if speed > STANDS else 0.0, min(1.0, drive))

    def acted(self, command: Command) -> None:
        """Does nothing: pure pursuit remembers no command."""

    def _seen(self, pose: Sequence[float]) -> Tuple[float, float]:
        """The point that is steered for, in the body frame [m]."""
        px, py, yaw = pose
        apart = np.hypot(self._points[:, 0] - px, self._points[:, 1] - py)
        if self._at < 0:
            self._at = int(apart.argmin())
        for _ in range(len(apart)):
            if apart[self._at] >= self.config.look_ahead or not self._go_on():
                break
        dx, dy = self._points[self._at] - (px, py)
        cos, sin = math.cos(yaw), math.sin(yaw)
        return cos * dx + sin * dy, cos * dy - sin * dx

    def _go_on(self) -> bool:
        """To the next point; false at the end of an open path."""
        if self._at + 1 == len(self._points) and not self._closed:
            self.ended = COMPLETED
            return False
        self._at = (self._at + 1) % len(self._points)
        return True
