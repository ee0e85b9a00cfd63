"""A drive on its way in: numpy arrays at the file's own rate, in SI units, with what is cut."""

from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from buggy_rl.recordings.errors import RecordingError


@dataclass
class Drive:
    """Rows of one file, T of them, in the units and axes of a `Recording`."""

    file: str
    t: ndarray
    """[T] s, as stamped."""
    pose: ndarray
    """[T, 3] x, y [m], yaw [rad]; yaw as the file has it, possibly wrapped."""
    linear: ndarray | None
    """[T, 2] vx, vy [m/s] in the body frame, or None where the file has none."""
    yaw_rate: ndarray | None
    """[T] rad/s, or None."""
    action: ndarray
    """[T, 2] throttle, steering in [-1, 1]."""
    row: ndarray
    """[T] row in the file."""
    labels: dict[str, str]
    """What the file calls a channel, e.g. `yaw` -> `vicon yaw`."""
    notes: list[str] = field(default_factory=list)
    keep: ndarray = field(init=False)
    """[T] bool, rows that may be used."""
    starts: ndarray = field(init=False)
    """[T] bool, rows before which a cut is made although no row is missing."""
    repeated: ndarray = field(init=False)
    """[T] bool, rows that carry no pose of their own; they do not count as lost."""
    longest_step: float = np.inf
    """[s] Kept neighbours further apart than this have a gap between them."""

    def __post_init__(self) -> None:
        self.keep = np.ones(len(self.t), bool)
        self.starts = np.zeros(len(self.t), bool)
        self.repeated = np.zeros(len(self.t), bool)

    @property
    def period(self) -> float:
        """Nominal time between kept rows [s]: the median."""
        return float(np.median(np.diff(self.t[self.keep])))

    @property
    def yaw(self) -> ndarray:
        """[T] rad, unwrapped; rows that are cut repeat the last kept one."""
        last = np.maximum.accumulate(np.where(self.keep, np.arange(len(self.t)), -1))
        return np.unwrap(self.pose[np.where(last < 0, np.argmax(self.keep), last), 2])

    def label(self, channel: str) -> str:
        """The file's name of a channel."""
        return self.labels.get(channel, channel)

    def refusal(self, index: int, channel: str, reason: str, remedy: str) -> RecordingError:
        """The error that names row `index` of these arrays by its row in the file."""
        return RecordingError(self.file, int(self.row[index]), self.label(channel), reason, remedy)

    def cut(self, rows: ndarray, channel: str, reason: str) -> None:
        """Takes the rows of a mask [T] out, and says so."""
        rows = rows & self.keep
        if rows.any():
            self.keep &= ~rows
            self.note(np.flatnonzero(rows), channel, f"{reason}: cut")

    def note(self, indices: ndarray, channel: str, text: str) -> None:
        """Adds a line that names the rows and the column."""
        self.notes.append(f"{self._rows(indices)}, column {self.label(channel)!r}: {text}")

    def _rows(self, indices: ndarray, most: int = 5) -> str:
        """`row 7`, `rows 7-9, 12`, or the first few and how many in all."""
        rows = self.row[indices]
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        shown = [str(run[0]) if len(run) == 1 else f"{run[0]}-{run[-1]}" for run in runs[:most]]
        more = f" ... ({len(rows)} rows in {len(runs)} places)" if len(runs) > most else ""
        return ("row " if len(rows) == 1 else "rows ") + ", ".join(shown) + more

    def stretches(self) -> list[ndarray]:
        """Index arrays of kept rows without a cut or a gap between them."""
        kept = np.flatnonzero(self.keep)
        if not len(kept):
            return []
        part = np.cumsum(self.starts)[kept]
        late = np.diff(self.t[kept]) > self.longest_step
        return np.split(kept, np.flatnonzero(late | (np.diff(part) > 0)) + 1)


def wrap(angle: ndarray) -> ndarray:
    """Wraps an angle [rad] of any shape to [-pi, pi)."""
    return np.remainder(angle + np.pi, 2 * np.pi) - np.pi


def turn(xy: ndarray, angle: ndarray | float) -> ndarray:
    """Turns vectors [*, 2] to the left by `angle` [*] rad."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = xy[..., 0], xy[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], -1)
