"""Where the car may be: a circle, a polygon, or anywhere."""

import math
from typing import Any, List, Mapping, NamedTuple, Sequence, Tuple, Union

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
    """No fence."""

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
