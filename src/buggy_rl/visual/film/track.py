"""A trajectory to be filmed: where a car was, what it was told, and the course it followed."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase

from buggy_rl.core import keys
from buggy_rl.recordings.recording import Recording
from buggy_rl.visual.film.shot import Points

Array = NDArray[Any]


@dataclass(frozen=True)
class PathLine:
    """The waypoints of a path."""

    points: Points
    """[W, 2] m; row 0 is the start and counts as closed."""
    closed: bool
    """The path goes on from its last waypoint to its first."""

    def waypoints(self, indices: NDArray[Any]) -> Points:
        """Waypoints [K, 2] by index; on a closed path indices count on over the laps."""
        return self.points[indices % len(self.points)]

    def whole(self) -> Points:
        """All waypoints, and the first once more if the path is closed."""
        return np.concatenate([self.points, self.points[: int(self.closed)]])

    def within(self, first: int, last: int) -> NDArray[Any]:
        """Indices from `first` to before `last`, as far as the path goes."""
        end = last if self.closed else min(last, len(self.points))
        return np.arange(max(first, 0), max(first, end, 0))


@dataclass(frozen=True)
class Track:
    """A trajectory of T rows.

    Raises:
        ValueError: It has fewer than two rows, columns of other lengths, time that does not
            increase, or a value that is not finite.
    """

    name: str
    """Name in the legend."""
    time: Array
    """[T] s since the film begins."""
    pose: Array
    """[T, 3] x, y [m], yaw [rad], world frame; yaw is unwrapped here."""
    velocity: Array
    """[T, 3] vx, vy [m/s], yaw_rate [rad/s], body frame."""
    action: Array
    """[T, 2] throttle, steering in [-1, 1]."""
    course: PathLine | None = None
    following: NDArray[Any] = field(default_factory=lambda: np.zeros(0, np.int64))
    """[T] index of the next waypoint; empty without a course."""

    restarts: Array = field(default_factory=lambda: np.zeros(0))
    """Times [s] at which a simulation was set back to what was measured."""
    reduced: float = 1.0
    """Lengths and speeds here are those of the car divided by this."""

    def __post_init__(self) -> None:
        rows = len(self.time)
        for name in ("pose", "velocity", "action"):
            if len(getattr(self, name)) != rows:
                have = len(getattr(self, name))
                raise ValueError(f"track {self.name!r}: {name} has {have} rows, time has {rows}")
        if rows < 2:
            raise ValueError(f"track {self.name!r} has {rows} rows: a film needs two at least")
        if not (np.diff(self.time) > 0).all():
            raise ValueError(f"track {self.name!r}: time must increase from row to row")
        motion = np.concatenate([self.pose, self.velocity, self.action], 1)
        if not np.isfinite(motion).all():
            row = int((~np.isfinite(motion)).any(1).argmax())
            raise ValueError(
                f"track {self.name!r} is not finite at {self.time[row]:.2f} s: end the film "
                f"before, with seconds={self.time[row]:.2f}"
            )
        object.__setattr__(self, "pose", _unwrapped(self.pose))

    @property
    def duration(self) -> float:
        """Time of the last row [s]."""
        return float(self.time[-1])

    def at(self, time: float) -> tuple[Array, Array, Array]:
        """Pose [3] and velocity [3], linear between rows, and the action [2] of the row before."""
        columns = np.concatenate([self.pose, self.velocity], 1)
        motion = np.array([np.interp(time, self.time, column) for column in columns.T])
        return motion[:3], motion[3:], self.action[self.row(time)]

    def drawn_at(self, length: float) -> "Track":
        """Track on a model `length` times smaller: cameras and marks are those of the buggy."""
        course = self.course and replace(self.course, points=self.course.points / length)
        pose = self.pose / np.array([length, length, 1.0])
        velocity = self.velocity / np.array([length, length, 1.0])
        return replace(self, pose=pose, velocity=velocity, course=course, reduced=length)

    def row(self, time: float) -> int:
        """The last row that is not later."""
        return int(np.clip(np.searchsorted(self.time, time + 1e-9, "right") - 1, 0, None))


def from_recording(recording: Recording, start: float = 0.0, seconds: float = np.inf) -> Track:
    """A track of what was measured, from `start` [s] to the next gap at the latest.

    Raises:
        ValueError: `start` is not within the recording, or falls into a gap.
    """
    rows = recording_rows(recording, start, seconds)
    data = recording.data[rows]
    time = data[keys.TIME].double().flatten().numpy()
    return Track(
        recording.name,
        time - time[0],
        data[keys.POSE].double().numpy(),
        data[keys.VELOCITY].double().numpy(),
        data[keys.ACTION].double().numpy(),
    )


def recording_rows(recording: Recording, start: float, seconds: float) -> slice:
    """Rows of a recording from `start` [s] on, for `seconds` or up to the next gap.

    Raises:
        ValueError: `start` is not within the recording, or falls into a gap.
    """
    time = recording.data[keys.TIME].flatten().numpy()
    time = time - time[0]
    segment = recording.data[keys.SEGMENT].flatten().numpy()
    first = int(np.searchsorted(time, start - recording.dt / 2))
    if start < 0 or first >= len(time) - 1:
        raise ValueError(f"start={start:g} s: recording {recording.name} ends at {time[-1]:.2f} s")
    if time[first] > start + recording.dt:
        raise ValueError(
            f"start={start:g} s falls into a gap of recording {recording.name}: the next row is "
            f"at {time[first]:.2f} s"
        )
    wanted = (time <= time[first] + seconds + recording.dt / 2) & (segment == segment[first])
    return slice(first, first + int(wanted[first:].sum()))


def from_rollout(
    rows: TensorDictBase, name: str, dt: float, course: PathLine | None = None
) -> Track:
    """A track of a rollout [T] of one environment, such as `env.rollout(T)[0]` of a batch.

    Args:
        rows: `pose`, `velocity` and `action`, and `next_waypoint` if there is a course.
        name: In the legend.
        dt: Control period [s].
        course: That was followed.
    """
    following: Array = np.zeros(0, np.int64)
    if course is not None:
        following = np.asarray(rows.get(keys.NEXT_WAYPOINT).flatten())
    pose, velocity, action = (
        np.asarray(rows.get(key).detach().cpu().double())
        for key in (keys.POSE, keys.VELOCITY, keys.ACTION)
    )
    return Track(name, dt * np.arange(len(pose)), pose, velocity, action, course, following)


def _unwrapped(pose: Array) -> Array:
    return np.column_stack([pose[:, :2], np.unwrap(pose[:, 2])])
