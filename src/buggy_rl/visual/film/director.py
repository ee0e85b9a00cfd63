"""Makes shots of tracks: what each frame shows, computed alike for a whole film and a live view."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.camera import CAMERAS
from buggy_rl.visual.film.canvas import MOST_GHOSTS
from buggy_rl.visual.film.shot import NO_POINTS, Points, Shot, ShownCar
from buggy_rl.visual.film.track import Array, Track

TRAIL = 2.5  # [s] shown of the past
AHEAD = 1.5  # [s] shown of the future where there is no course
WAYPOINTS_AHEAD, WAYPOINTS_BEHIND = 14, 4
STRIDE = 0.04  # [m] between two points of a ribbon
MOST_PIECES = 800  # of a ribbon; a long film seen as a whole has wider strides
BETWEEN = np.array([0.0, 0.25, 0.5, 0.75])  # waypoints are 0.2 m apart: pieces of 0.05 m


@dataclass(frozen=True)
class Director:
    """Says what is seen at a time.

    Raises:
        ValueError: The camera is unknown, or there are more than three tracks.
    """

    tracks: Sequence[Track]
    """The car's, then those of up to two ghosts."""
    camera: str = "chase"
    """A name in `CAMERAS`."""
    aspect: float = 4 / 3
    """Width of the picture over its height."""
    full_lock: float = wheels.FULL_LOCK
    """Angle of the road wheels at steering 1 [rad]."""
    dimensions: VehicleDimensions = field(default_factory=VehicleDimensions)

    def __post_init__(self) -> None:
        if self.camera not in CAMERAS:
            raise ValueError(f"camera={self.camera!r}: must be one of {', '.join(CAMERAS)}")
        if not 1 <= len(self.tracks) <= 1 + MOST_GHOSTS:
            raise ValueError(
                f"{len(self.tracks)} tracks: a film shows a car and at most {MOST_GHOSTS} ghosts"
            )

    def times(self, fps: float, playback: float = 1.0) -> NDArray[Any]:
        """Times [N] in s of the frames of a film, as long as the car drives.

        Args:
            fps: Frames a second of the film.
            playback: Seconds of driving in a second of film; 0.25 is slow motion.
        """
        count = int(np.floor(self.tracks[0].duration * fps / playback + 1e-6)) + 1
        return np.arange(count) * playback / fps

    def moment(self, time: float) -> float:
        """A time [s] of the film; below 0 stands for its middle.

        Raises:
            ValueError: The film is over by then.
        """
        duration = self.tracks[0].duration
        if time > duration:
            raise ValueError(f"moment={time:g} s: the film ends at {duration:.2f} s")
        return time if time >= 0 else duration / 2

    def shot(self, time: float) -> Shot:
        """What is seen at a time [s]; a ghost whose track has ended stays where it is."""
        cars = [self._car(index, time) for index in range(len(self.tracks))]
        view = CAMERAS[self.camera](self.tracks, time, self.aspect)
        waypoints, closed_for = _waypoints(self.tracks[0], time)
        ahead = _ahead(self.tracks[0], time, whole=self.camera == "fixed")
        return Shot(time, view, cars[0], tuple(cars[1:]), ahead, waypoints, closed_for)

    def _car(self, index: int, time: float) -> ShownCar:
        track = self.tracks[index]
        (x, y, yaw), (vx, _, _), (throttle, steering) = (p.tolist() for p in track.at(time))
        roll = np.array([np.interp(time, track.time, wheel) for wheel in self._rolled[index].T])
        angle = float(wheels.steering_angle(np.array(steering), self.full_lock))
        trail = _spaced(track, self._trail_start(track, time), track.row(time))
        speed = vx * track.reduced
        return ShownCar(track.name, x, y, yaw, speed, throttle, steering, angle, roll, trail)

    def _trail_start(self, track: Track, time: float) -> int:
        """Row of the last restart; no longer ago than `TRAIL`, unless the camera stands still."""
        past = track.restarts[track.restarts <= time + 1e-9]
        earliest = 0.0 if self.camera == "fixed" else time - TRAIL
        return track.row(max(earliest, past[-1] if len(past) else 0.0))

    @cached_property
    def _rolled(self) -> list[Array]:
        """Roll angles [T, 4] of each track's wheels."""
        found = []
        for track in self.tracks:
            angle = wheels.steering_angle(track.action[:, 1], self.full_lock)
            found.append(wheels.rolled(track.time, track.velocity, angle, self.dimensions))
        return found


def _ahead(track: Track, time: float, whole: bool) -> Points:
    """The course from the waypoint behind the car on; without one, where the car will be."""
    if track.course is None:
        end = track.duration if whole else time + AHEAD
        return _spaced(track, track.row(time), track.row(end))
    if whole:
        return _curve(track.course.whole())
    following = int(track.following[track.row(time)])
    indices = track.course.within(following - 1, following + WAYPOINTS_AHEAD)
    return _curve(track.course.waypoints(indices))


def _waypoints(track: Track, time: float) -> tuple[Points, Array]:
    """Waypoints [K, 2] about the car, and for how long each has been closed [s]; -1 if it is open.

    The start, which nobody has to close, is not among them.
    """
    if track.course is None:
        return NO_POINTS, np.zeros(0)
    row = track.row(time)
    following = int(track.following[row])
    first = max(1, following - WAYPOINTS_BEHIND)
    indices = track.course.within(first, following + WAYPOINTS_AHEAD)
    closing = np.searchsorted(track.following, indices, "right")  # row at which each was closed
    closed = track.time[np.minimum(closing, len(track.time) - 1)]
    age = np.where(indices < following, time - closed, -1.0)
    return track.course.waypoints(indices), age


def _spaced(track: Track, first: int, last: int) -> Points:
    """Positions of rows from `first` to `last`, about a stride apart; both ends are kept."""
    points = track.pose[first : last + 1, :2]
    run = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T).cumsum()])
    stride = max(STRIDE, float(run[-1]) / MOST_PIECES)
    kept = np.flatnonzero(np.diff(run // stride, prepend=-1.0))
    return points[np.union1d(kept, len(points) - 1)]


def _curve(points: Points) -> Points:
    """A Catmull-Rom spline through points [K, 2]."""
    if len(points) < 3:
        return points
    ends = 2 * points[[0, -1]] - points[[1, -2]]
    a, b, c, d = (np.concatenate([ends[:1], points, ends[1:]])[k : k + len(points) - 1]
                  for k in range(4))  # fmt: skip
    t = BETWEEN[:, None, None]
    pieces = b + t / 2 * (c - a + t * (2 * a - 5 * b + 4 * c - d + t * (3 * (b - c) + d - a)))
    return np.concatenate([pieces.transpose(1, 0, 2).reshape(-1, 2), points[-1:]])
