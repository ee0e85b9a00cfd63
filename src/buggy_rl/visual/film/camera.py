"""Cameras of a film: behind the car, above it, or from where all can be seen."""

import math
from collections.abc import Callable, Sequence

import numpy as np

from buggy_rl.visual.film.shot import View
from buggy_rl.visual.film.track import Track

FIELD = math.radians(45)  # vertical field of view, MuJoCo's default
SETTLING = 0.22  # [s] time constant with which the camera follows turns and distances
MEMORY = 5 * SETTLING  # [s] that is weighted; what is older counts less than 1 %
ROOM = 0.5  # [m] around cars that are shown together
MARGIN = 0.35  # [m] around what a fixed camera shows
FARTHEST = 2.6  # [m] to which a moving camera draws back for a ghost that is far away


def chase_view(tracks: Sequence[Track], time: float, aspect: float) -> View:
    """View from behind and above, with a heading that follows the car's."""
    del aspect
    x, y, yaw = _followed(tracks, time)
    apart = _apart(tracks, time)
    heading = float(_smoothed(tracks[0], tracks[0].pose[:, 2], time))
    distance = min(0.85 + 0.9 * apart, FARTHEST)
    ahead = 0.16
    x, y = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
    return View(x, y, 0.05, distance, heading, math.radians(-20))


def top(tracks: Sequence[Track], time: float, aspect: float) -> View:
    """View from above, x to the right and y up, over the car."""
    del aspect
    x, y, _ = _followed(tracks, time)
    distance = 2.0 + min(1.2 * _apart(tracks, time), FARTHEST)
    return View(x, y, 0.0, distance, math.pi / 2, -math.pi / 2)


def fixed(tracks: Sequence[Track], time: float, aspect: float) -> View:
    """Stands still where all that is driven can be seen."""
    del time
    courses = [track.course.points for track in tracks if track.course is not None]
    points = np.concatenate([track.pose[:, :2] for track in tracks] + courses)
    low, high = points.min(0) - MARGIN, points.max(0) + MARGIN
    (x, y), (width, depth) = (low + high) / 2, high - low
    elevation = math.radians(-52)
    # What is nearer than the middle looks larger: half of the depth is added to the distance.
    half = max(width / aspect, depth * math.sin(-elevation)) / 2
    distance = half / math.tan(FIELD / 2) + depth / 2 * math.cos(elevation)
    return View(float(x), float(y), 0.0, float(distance), math.pi / 2, elevation)


def together(tracks: Sequence[Track], time: float, aspect: float) -> View:
    """View from the south, as near as all cars fit into the picture."""
    (x, y, _), _, _ = tracks[0].at(time)
    apart = [[_difference(tracks[0], ghost, time, axis) for axis in (0, 1)] for ghost in tracks[1:]]
    low, high = np.min([[0.0, 0.0], *apart], 0), np.max([[0.0, 0.0], *apart], 0)
    (dx, dy), (width, depth) = (low + high) / 2, high - low
    elevation = math.radians(-42)
    half = ROOM + max(width / aspect, depth * math.sin(-elevation)) / 2
    distance = half / math.tan(FIELD / 2) + depth / 2 * math.cos(elevation)
    return View(float(x + dx), float(y + dy), 0.0, float(distance), math.pi / 2, elevation)


CAMERAS: dict[str, Callable[[Sequence[Track], float, float], View]] = {
    "chase": chase_view,
    "top": top,
    "fixed": fixed,
    "together": together,
}


def _followed(tracks: Sequence[Track], time: float) -> tuple[float, float, float]:
    """Pose of the car, up to a third of the way towards the first ghost if that is not too far."""
    (x, y, yaw), _, _ = tracks[0].at(time)
    share = 1 / 3 if len(tracks) > 1 else 0.0
    if share:
        dx, dy = (_difference(tracks[0], tracks[1], time, axis) for axis in (0, 1))
        share *= min(1.0, FARTHEST / 2 / max(math.hypot(dx, dy), 1e-9))
        x, y = x + share * dx, y + share * dy
    return float(x), float(y), float(yaw)


def _apart(tracks: Sequence[Track], time: float) -> float:
    """Distance of the farthest ghost [m]; 0 without one."""
    found = [[_difference(tracks[0], g, time, axis) for axis in (0, 1)] for g in tracks[1:]]
    return max((math.hypot(*difference) for difference in found), default=0.0)


def _difference(car: Track, ghost: Track, time: float, axis: int) -> float:
    """Distance from car to ghost along an axis [m], smoothed: a ghost that restarts leaps."""
    other = np.interp(car.time, ghost.time, ghost.pose[:, axis])
    return float(_smoothed(car, other - car.pose[:, axis], time))


def _smoothed(track: Track, values: np.ndarray, time: float) -> float:
    """First-order lag of a column [T], from its past alone: a camera that needs no state."""
    last = track.row(time)
    first = track.row(time - MEMORY)
    weight = np.exp((track.time[first : last + 1] - time) / SETTLING)
    return float(weight @ values[first : last + 1] / weight.sum())
