"""Every limit that stops the car or bounds its commands, and the fence that it may not leave."""

import math
from typing import Any, List, Mapping, NamedTuple, Sequence, Tuple, Union

from buggy_rl.car.settings import section


class Safety(NamedTuple):
    """Limits on readings, commands and time."""

    coast_after: float = 0.05
    """Time without a good reading [s]: no drive, steering kept. Five periods of the camera."""
    disarm_after: float = 0.25
    """Time without recovery [s]: no drive, wheels straight, to be armed again."""
    recovered_after: float = 0.1
    """Time of good readings without a pause [s] before a coasting car drives on."""
    least_confidence: float = 0.5
    """Confidence of the tracker, in [0, 1]; the T265 says 0.33 for low, 0.67 for medium."""
    farthest: float = 100.0
    """|x| and |y| of a sound pose [m]."""
    top_speed: float = 15.0
    """Speed of a sound reading [m/s]; 1.5 times the fastest that cars of this class are driven."""
    top_yaw_rate: float = 25.0
    """Yaw rate of a sound reading [rad/s]; 3.5 times a small car's 7 rad/s."""
    jump_distance: float = 0.05
    """Granted between the change of position and the velocity times time [m]."""
    jump_angle: float = 0.1
    """Granted between the change of yaw and the yaw rate times time [rad]."""
    jump_speed: float = 1.0
    """Granted to a change of vx or vy [m/s]: 10 g over 10 ms."""
    drift_distance: float = 0.1
    """Granted to the sum of those differences over 0.2 s [m]: velocities wrong by 0.5 m/s."""
    acceleration: float = 20.0
    """Widens the limits with time [m/s^2]; 2 g, twice the grip of rubber."""
    yaw_acceleration: float = 100.0
    """Widens the limit of yaw with time [rad/s^2]; half of full tyre force at both axles."""
    throttle_cap: float = 0.0
    """Highest throttle, in [-1, 1]; 0 is half of the drive, or none where the car reverses."""
    throttle_floor: float = -1.0
    """Lowest throttle, in [-1, 1]: of a car that brakes and reverses, how much at most."""
    throttle_rise: float = 20.0
    """Fastest rise of the throttle [1/s]; it falls at once."""
    steering_rate: float = 40.0
    """Fastest change of the steering [1/s]; three times the servo's own."""
    max_seconds: float = 60.0
    """Longest drive, from the first arming [s]."""

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Safety":
        """Limits that differ from the defaults.

        Raises:
            ValueError: A key is unknown, or a value is outside its range.
        """
        made = section(cls, content, "safety", RANGES)
        if made.throttle_floor > made.throttle_cap:
            raise ValueError(
                f"safety.throttle_floor={made.throttle_floor:g}: must be at most throttle_cap "
                f"{made.throttle_cap:g}"
            )
        if made.disarm_after < made.coast_after:
            raise ValueError(
                f"safety.disarm_after={made.disarm_after:g} s: must be at least coast_after "
                f"{made.coast_after:g} s"
            )
        return made


RANGES = {
    "coast_after": (0.01, 0.1),  # [s] beyond, the drive is not cut within 0.15 s
    "disarm_after": (0.01, 0.5),
    "recovered_after": (0.02, 2.0),
    "least_confidence": (0.0, 1.0),
    "farthest": (0.5, 10000.0),
    "top_speed": (0.5, 50.0),
    "top_yaw_rate": (1.0, 100.0),
    "jump_distance": (0.005, 1.0),
    "jump_angle": (0.01, 1.0),
    "jump_speed": (0.05, 10.0),
    "drift_distance": (0.01, 1.0),
    "acceleration": (1.0, 200.0),
    "yaw_acceleration": (10.0, 2000.0),
    "throttle_cap": (-1.0, 1.0),
    "throttle_floor": (-1.0, 1.0),
    "throttle_rise": (0.1, 200.0),
    "steering_rate": (0.1, 200.0),
    "max_seconds": (0.1, 7200.0),
}


FEWEST = 3  # corners of a polygon


class Circle(NamedTuple):
    """All points at most `radius` from a centre [m]."""

    x: float
    y: float
    radius: float

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is inside."""
        return math.hypot(x - self.x, y - self.y) <= self.radius


class Polygon(NamedTuple):
    """A simple polygon; corners [m] in either order."""

    corners: Tuple[Tuple[float, float], ...]

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is inside: a ray from it crosses the edges an odd number of times."""
        inside = False
        for (ax, ay), (bx, by) in zip(self.corners, self.corners[1:] + self.corners[:1]):
            if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
                inside = not inside
        return inside


class Anywhere(NamedTuple):
    """Fence that encloses everything."""

    def holds(self, x: float, y: float) -> bool:
        """Whether a point is inside: always."""
        return True


Geofence = Union[Circle, Polygon, Anywhere]


def make_geofence(about: Union[str, Mapping[str, Any]]) -> Geofence:
    """The fence that `"none"`, `{"circle": [x, y, radius]}` or `{"polygon": [[x, y], ...]}` names.

    Raises:
        ValueError: It is none of these, or a number is not finite.
    """
    if about == "none":
        return Anywhere()
    if isinstance(about, Mapping) and len(about) == 1:
        kind, numbers = next(iter(about.items()))
        if kind == "circle":
            x, y, radius = _numbers(numbers, 3, "geofence.circle")
            if radius <= 0:
                raise ValueError(f"geofence.circle: radius {radius:g} m: must be above 0")
            return Circle(x, y, radius)
        if kind == "polygon":
            return Polygon(_corners(numbers))
    raise ValueError(
        f'geofence={about!r}: must be "none", {{"circle": [x, y, radius]}} or '
        f'{{"polygon": [[x, y], ...]}}, in metres'
    )


def _corners(about: Any) -> Tuple[Tuple[float, float], ...]:
    if not isinstance(about, (list, tuple)) or len(about) < FEWEST:
        raise ValueError(f"geofence.polygon={about!r}: must be {FEWEST} or more corners [x, y]")
    found = [_numbers(corner, 2, "geofence.polygon") for corner in about]
    return tuple((x, y) for x, y in found)


def _numbers(about: Any, count: int, name: str) -> List[float]:
    right = isinstance(about, Sequence) and len(about) == count
    if not right or not all(isinstance(v, (int, float)) and math.isfinite(v) for v in about):
        raise ValueError(f"{name}={about!r}: must be {count} finite numbers [m]")
    return [float(value) for value in about]
