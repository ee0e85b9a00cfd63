"""A path for the car: its file, the queue of waypoints on it, and pure pursuit along it."""

import csv
import math
import os
from typing import Any, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from buggy_rl.car.interfaces import Command
from buggy_rl.car.settings import section

FEWEST = 3  # waypoints of a path: a tangent needs a neighbour on either side
Points = Union[np.ndarray, Sequence[Sequence[float]]]
SAME_PLACE = 1e-6  # [m] a last row this near to the first closes the path


class Tables(NamedTuple):
    """What following looks up, one row for each waypoint and for those shown beyond the last."""

    points: np.ndarray
    """[R, 2] float32 x, y [m]."""
    turned: np.ndarray
    """[R, 2] float32 y, -x [m]: the points turned to the right by a quarter."""
    tangents: np.ndarray
    """[R, 2] float32 unit vectors along the path, through the neighbours of each waypoint."""
    along: np.ndarray
    """[R, 2] float32 unit vectors of the straight pieces that end at each waypoint."""
    length: np.ndarray
    """[R] float32 of those pieces [m]."""


class Path:
    """Waypoints to follow.

    Args:
        points: [W, 2] x, y [m], at least 3.
        closed: The path goes on from its last waypoint to its first.
        name: For messages.

    Raises:
        ValueError: There are too few points, one is not finite, or one repeats its neighbour.
    """

    def __init__(self, points: Points, closed: bool, name: str = "path") -> None:
        self.points = np.asarray(points, np.float32)
        self.closed, self.name = closed, name
        if self.points.ndim != 2 or self.points.shape[1] != 2 or len(self.points) < FEWEST:
            shape = list(self.points.shape)
            raise ValueError(f"{name}: waypoints have shape {shape}: needed are [3 or more, 2]")
        for row, point in enumerate(self.points):
            if not np.isfinite(point).all():
                raise ValueError(f"{name}: waypoint {row} is not finite")
        for kind, chord in (
            ("repeats its neighbour", self._steps()),
            ("turns back", self._chords()),
        ):
            short = np.flatnonzero(np.hypot(chord[:, 0], chord[:, 1]) < SAME_PLACE)
            if len(short):
                raise ValueError(f"{name}: the path {kind} at waypoint {short[0]}: take it out")

    def __len__(self) -> int:
        return len(self.points)

    def placed(self, pose: Sequence[float]) -> "Path":
        """The same path for a car that stands at `pose` (x, y [m], yaw [rad]) instead of at 0."""
        x, y, yaw = pose
        cos, sin = math.cos(yaw), math.sin(yaw)
        own = self.points.astype(np.float64)
        moved = [x + cos * own[:, 0] - sin * own[:, 1], y + sin * own[:, 0] + cos * own[:, 1]]
        return Path(np.stack(moved, -1), self.closed, self.name)

    def tables(self, ahead: int) -> Tables:
        """The waypoints and `ahead` more: a closed path again, an open one straight on."""
        points = self._extended(ahead)
        step = np.diff(np.concatenate([self._before(), points]), axis=0)
        chord = self._chords(ahead)
        length = _norm(step)
        turned = np.stack([points[:, 1], -points[:, 0]], -1)
        return Tables(
            np.ascontiguousarray(points),
            np.ascontiguousarray(turned),
            chord / _norm(chord)[:, None],
            step / length[:, None],
            length,
        )

    def _before(self) -> np.ndarray:
        """[1, 2] the waypoint before the first; an open path comes to it straight."""
        return self.points[-1:] if self.closed else 2 * self.points[:1] - self.points[1:2]

    def _extended(self, ahead: int) -> np.ndarray:
        """[W + ahead, 2]."""
        count = len(self.points)
        if self.closed:
            return self.points[np.arange(count + ahead) % count]
        run = np.arange(1, ahead + 1, dtype=np.float32)[:, None]
        beyond = self.points[-1] + run * (self.points[-1] - self.points[-2])
        return np.concatenate([self.points, beyond])

    def _steps(self) -> np.ndarray:
        """[W or W - 1, 2] from each waypoint to the next."""
        return np.diff(self._extended(1 if self.closed else 0), axis=0)

    def _chords(self, ahead: int = 0) -> np.ndarray:
        """[W + ahead, 2] from each waypoint's neighbour before it to the one behind."""
        points = np.concatenate([self._before(), self._extended(ahead + 1)])
        return points[2:] - points[:-2]


def _norm(vectors: np.ndarray) -> np.ndarray:
    """[R] lengths of vectors [R, 2], float32, rounded as PyTorch's `norm` with fused multiply-add.

    A tangent that differs in its last bit closes one waypoint in a million a step apart.
    """
    x, y = vectors[:, 0], vectors[:, 1].astype(np.float64)
    return np.sqrt(((x * x).astype(np.float64) + y * y).astype(np.float32))


def load_path(file: str) -> Path:
    """Reads a CSV with columns x, y [m]; the path is closed when its last row repeats its first.

    Raises:
        ValueError: It is no such file; the message names file and row.
    """
    if not os.path.isfile(file):
        raise ValueError(
            f"there is no path file {file}: name a CSV with columns x, y, as "
            "scripts/export_policy.py writes beside a policy"
        )
    with open(file, newline="") as stream:
        rows = list(csv.DictReader(stream))
    if not rows or not {"x", "y"} <= set(rows[0]):
        given = ", ".join(str(name) for name in rows[0]) if rows else "no rows"
        raise ValueError(
            f"{file} has {given}: it needs columns x and y and a row for each waypoint"
        )
    points = [_point(row, file, number) for number, row in enumerate(rows, 2)]
    (x, y), (last_x, last_y) = points[0], points[-1]
    closed = math.hypot(x - last_x, y - last_y) < SAME_PLACE
    name = os.path.splitext(os.path.basename(file))[0]
    return Path(points[:-1] if closed else points, closed, name)


def _point(row: dict, file: str, number: int) -> Tuple[float, float]:
    try:
        x, y = float(row["x"]), float(row["y"])
        if math.isfinite(x) and math.isfinite(y):
            return x, y
    except (TypeError, ValueError):
        pass  # said below, as for numbers that are not finite
    given = "{}, {}".format(row["x"], row["y"])
    raise ValueError(f"{file}, row {number}: x, y are {given}, not two finite numbers [m]")


def path_lines(path: Path) -> List[str]:
    """The lines of a file that `load_path` reads back without a difference."""
    points = np.concatenate([path.points, path.points[:1]]) if path.closed else path.points
    return ["x,y"] + [f"{float(x):.9g},{float(y):.9g}" for x, y in points]


class Waypoints:
    """Closes the waypoints that the car passes and shows the next ones.

    Waypoint w with tangent t is closed by a car at p when

        (p - w) . t > 0  and  |(p - w) x t| <= lateral_bound,

    one after the other, at most `at_once` in a step.

    Args:
        visible: Waypoints shown.
        lateral_bound: [m] beside a waypoint that still counts.
        at_once: Most that one step closes.
    """

    def __init__(self, visible: int, lateral_bound: float, at_once: int) -> None:
        self.visible, self.at_once = visible, at_once
        self._bound = np.float32(lateral_bound)
        self.closed = 0  # in the last step
        self.next = 1  # goes on over the laps of a closed path
        self._path: Optional[Path] = None
        self._count = 0  # waypoints of the path
        self._row = 1  # of the next waypoint in the tables
        self._scratch = np.empty((visible, 2), np.float32)

    def follow(self, path: Path) -> None:
        """Begins a path; its first waypoint is where the car stands."""
        self._path, self._count = path, len(path)
        self._tables: Tables = path.tables(self.visible + 1)
        self.closed, self.next, self._row = 0, 1, 1

    @property
    def completed(self) -> bool:
        """An open path has no waypoint left."""
        assert self._path is not None
        return not self._path.closed and self.next >= self._count

    def advance(self, x: np.float32, y: np.float32) -> None:
        """Closes waypoints for a car at x, y [m]."""
        assert self._path is not None
        left = self.at_once if self._path.closed else min(self.at_once, self._count - self.next)
        self.closed = 0
        while self.closed < left and self._passed(self._row + self.closed, x, y):
            self.closed += 1
        self.next += self.closed
        self._row = self.next % self._count if self._path.closed else self.next

    def _passed(self, row: int, x: np.float32, y: np.float32) -> bool:
        (wx, wy), (tx, ty) = self._tables.points[row], self._tables.tangents[row]
        dx, dy = x - wx, y - wy
        return bool(dx * tx + dy * ty > 0 and abs(dx * ty - dy * tx) <= self._bound)

    def see(self, x: np.float32, y: np.float32, yaw: np.float32, out: np.ndarray) -> None:
        """Writes the next waypoints into `out` [visible, 2]: R(-yaw) (w - p) [m]."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        rows = slice(self._row, self._row + self.visible)
        np.multiply(self._tables.points[rows], cos, out=out)
        np.multiply(self._tables.turned[rows], sin, out=self._scratch)
        np.add(out, self._scratch, out=out)
        out -= (cos * x + sin * y, cos * y - sin * x)

    def errors(self, x: np.float32, y: np.float32, yaw: np.float32) -> Tuple[float, float]:
        """Distance from the piece that ends at the next waypoint [m], and heading error [rad].

        Both are positive to the left.
        """
        along_x, along_y = self._tables.along[self._row]
        end_x, end_y = self._tables.points[self._row]
        dx, dy = x - end_x, y - end_y
        short = -(dx * along_x + dy * along_y)
        within = min(max(short, np.float32(0)), self._tables.length[self._row])
        beside = along_x * dy - along_y * dx
        distance = math.copysign(np.hypot(short - within, beside), beside)
        turn = float(yaw) - math.atan2(along_y, along_x)
        return distance, (turn + math.pi) % (2 * math.pi) - math.pi


WHEELBASE = 0.174  # [m] of the project's own car
COMPLETED = "completed the path"
STANDS = 0.3  # [m/s] speed below which it is not braked: the command would reverse it
CREEP = 0.05  # [m/s] added to the speed of a weave that would stand still


class PursuitConfig(NamedTuple):
    """Distances, speeds and gains."""

    look_ahead: float = 0.45
    """Distance to the point that is steered for [m]."""
    speed: float = 1.2
    """Speed to hold [m/s]."""
    weave: float = 0.0
    """Share by which the speed swings about it, and the steering swings with it."""
    period: float = 3.0
    """Period of the swing of the speed [s]; that of the steering is a fifth."""
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
        """Makes a pursuit, for a car that may reverse, from the fields of `PursuitConfig`."""
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
        """Throttle of a drive; below 0 it brakes a car that can, while that rolls."""
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
        """Goes on to the next point; false at the end of an open path."""
        if self._at + 1 == len(self._points) and not self._closed:
            self.ended = COMPLETED
            return False
        self._at = (self._at + 1) % len(self._points)
        return True
