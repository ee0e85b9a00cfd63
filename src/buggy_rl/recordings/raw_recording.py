"""A recording before resampling: numpy arrays at the file's rate, SI units, with excluded rows."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.recording import RecordingError


@dataclass
class RawRecording:
    """Rows of one file, T of them, in the units and axes of a `Recording`."""

    file: str
    t: ndarray
    """[T] s, as stamped."""
    pose: ndarray
    """[T, 3] x, y [m], yaw [rad]; yaw as in the file, possibly wrapped."""
    linear: ndarray | None
    """[T, 2] vx, vy [m/s] in the body frame, or None where the file has none."""
    yaw_rate: ndarray | None
    """[T] rad/s, or None."""
    action: ndarray
    """[T, 2] throttle, steering in [-1, 1]."""
    row: ndarray
    """[T] row in the file."""
    labels: dict[str, str]
    """Channel -> column of the file, e.g. `yaw` -> `vicon yaw`."""
    notes: list[str] = field(default_factory=list)
    beside: Mapping[str, ndarray] = field(default_factory=dict)
    """Channel -> [T] of sensors beside the tracker, in SI units; NaN where there is no value."""
    derived: tuple[str, ...] = ()
    """Columns of the velocity that follow from the pose."""
    reverse: bool = False
    """Whether the command has reverse, so that driving backward is no fault."""
    rest_declared: bool = False
    """Whether the column map says what the command is at rest."""
    keep: ndarray = field(init=False)
    """[T] bool, rows that are used."""
    starts: ndarray = field(init=False)
    """[T] bool, rows that start a segment although no row is missing before them."""
    repeated: ndarray = field(init=False)
    """[T] bool, rows that repeat the pose of a slower tracker; they do not count as lost."""
    backward: ndarray = field(init=False)
    """[T] bool, rows in which the car reverses; they do not count as lost either."""
    longest_step: float = np.inf
    """[s] Longest time between two kept rows of a segment."""

    def __post_init__(self) -> None:
        self.keep = np.ones(len(self.t), bool)
        self.starts = np.zeros(len(self.t), bool)
        self.repeated = np.zeros(len(self.t), bool)
        self.backward = np.zeros(len(self.t), bool)

    @property
    def period(self) -> float:
        """Median time between kept rows [s]."""
        return float(np.median(np.diff(self.t[self.keep])))

    @property
    def yaw(self) -> ndarray:
        """[T] rad, unwrapped; excluded rows repeat the last kept one."""
        last = np.maximum.accumulate(np.where(self.keep, np.arange(len(self.t)), -1))
        return np.unwrap(self.pose[np.where(last < 0, np.argmax(self.keep), last), 2])

    def label(self, channel: str) -> str:
        """The file's name of a channel."""
        return self.labels.get(channel, channel)

    def error(self, index: int, channel: str, message: str) -> RecordingError:
        """The error at row `index` of these arrays; it names the row of the file."""
        return RecordingError(self.file, message, int(self.row[index]), self.label(channel))

    def rows(self, seconds: float, least: int = 1) -> int:
        """Number of rows in a time span."""
        return max(least, round(seconds / self.period))

    def drop(self, rows: ndarray) -> None:
        """Takes the rows of a mask [T] away, which `cut` leaves in place."""
        left = ~rows
        self.starts[1:] |= rows[:-1] & self.starts[:-1]
        for name in ("t", "pose", "linear", "yaw_rate", "action", "row"):
            values = getattr(self, name)
            setattr(self, name, None if values is None else values[left])
        for name in ("keep", "starts", "repeated", "backward"):
            setattr(self, name, getattr(self, name)[left])
        self.beside = {channel: values[left] for channel, values in self.beside.items()}

    def cut(self, rows: ndarray, channel: str, reason: str) -> None:
        """Excludes the rows of a mask [T] and notes them."""
        rows = rows & self.keep
        if rows.any():
            self.keep &= ~rows
            self.note(np.flatnonzero(rows), channel, f"{reason}: cut")

    def note(self, indices: ndarray, channel: str, text: str) -> None:
        """Adds a line that names the rows and the column."""
        self.note_column(channel, text, f"{self._rows(indices)}, ")

    def note_column(self, channel: str, text: str, rows: str = "") -> None:
        """Adds a line that names the column."""
        self.notes.append(f"{rows}column {self.label(channel)}: {text}")

    def _rows(self, indices: ndarray, most: int = 5) -> str:
        """`row 7`, `rows 7-9, 12`, or the first few and their number."""
        rows = self.row[indices]
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        shown = [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs[:most]]
        more = f" ... ({len(rows)} rows in {len(runs)} places)" if len(runs) > most else ""
        return ("row " if len(rows) == 1 else "rows ") + ", ".join(shown) + more

    def segments(self) -> list[ndarray]:
        """Indices of consecutive kept rows without a gap between them."""
        kept = np.flatnonzero(self.keep)
        if not len(kept):
            return []
        part = np.cumsum(self.starts)[kept]
        late = np.diff(self.t[kept]) > self.longest_step
        return np.split(kept, np.flatnonzero(late | (np.diff(part) > 0)) + 1)


def wrap_angles(angle: ndarray) -> ndarray:
    """Wraps an angle [rad] of any shape to [-pi, pi)."""
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def rotate_rows(xy: ndarray, angle: ndarray | float) -> ndarray:
    """Rotates vectors [*, 2] to the left by `angle` [*] rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], -1)


def robust_deviation(deviation: ndarray) -> float:
    """Standard deviation of normal noise from its absolute values, insensitive to outliers.

    sigma = 1.4826 median(|e|).
    """
    return 1.4826 * float(np.median(deviation))
