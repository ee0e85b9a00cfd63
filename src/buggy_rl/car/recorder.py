"""The recording of a drive, off the loop, and which command acted at the stamp of a reading."""

import collections
import contextlib
import math
import os
import threading
from typing import Deque, NamedTuple, Tuple

from buggy_rl.car.interfaces import NEUTRAL, Command, Reading
from buggy_rl.car.messages import Report
from buggy_rl.car.readings import FUTURE

KEPT = 200  # commands; 2 s at 100 Hz, eight times the age at which a reading disarms


class Written(NamedTuple):
    """A command, and when the actuator took it [s]."""

    stamp: float
    throttle: float
    steering: float


class CommandHistory:
    """The commands that the actuator took last; neutral before the first."""

    def __init__(self, at_rest: Command = NEUTRAL) -> None:
        self._written: Deque[Written] = collections.deque(maxlen=KEPT)
        self._written.append(Written(-math.inf, *at_rest))

    def add(self, report: Report) -> None:
        """Takes a report; a write that failed changes nothing at the wheels."""
        if report.taken:
            self._written.append(Written(report.stamp, report.throttle, report.steering))

    def at(self, stamp: float) -> Written:
        """The command that acted at a time: the last one at or before it."""
        for written in reversed(self._written):
            if written.stamp <= stamp:
                return written
        return self._written[0]


COLUMNS = (
    *("t", "x", "y", "yaw", "vx", "vy", "yaw_rate", "throttle", "steering"),
    *("confidence", "armed", "source", "command_t"),
)
"""The first nine are those of every recording; the others are for people."""
WRITE_PERIOD = 0.05  # [s] between two writes: a full disk is known within it
SYNC_PERIOD = 0.25  # [s] between two syncs; a power-off loses this and the time of one fsync
LONGEST_CLOSE = 10.0  # [s] that a disk has for the last rows
MOST_WAITING = 6000  # rows, a minute at 100 Hz, that a slow disk may be behind


class RecorderRow(NamedTuple):
    """A reading, the command that acted at its stamp, and who commanded."""

    reading: Reading
    written: Written
    armed: bool
    source: str

    @property
    def finite(self) -> bool:
        """The reading has numbers only; a pose that is none says nothing a gap does not."""
        return all(map(math.isfinite, (*self.reading.pose, *self.reading.velocity)))

    def line(self, origin: float) -> str:
        """The line of the file; times [s] count from `origin`."""
        reading, written = self.reading, self.written
        numbers = (*reading.pose, *reading.velocity, written.throttle, written.steering)
        about = f"{reading.confidence:.2f},{int(self.armed)},{self.source}"
        command_t = f"{written.stamp - origin:.6f}" if math.isfinite(written.stamp) else ""
        motion = ",".join(map(repr, numbers))
        return f"{reading.stamp - origin:.6f},{motion},{about},{command_t}\n"


class DriveRecorder:
    """Writes rows in a thread; the loop only leaves them in a queue.

    Left out and counted are rows with a number that is not finite, and those whose stamp is not
    after the last one's or is in the future: time never runs back in a recording.

    Args:
        path: A new .csv.
        origin: Time [s] that the recording counts from.

    Raises:
        OSError: The file exists or cannot be made.
    """

    def __init__(self, path: str, origin: float) -> None:
        self.path, self.origin = path, origin
        self.rows = 0
        """Rows taken so far."""
        self.left_out = 0
        """Rows that were left out so far."""
        self.error = ""
        """Why no more can be recorded; empty if all is well."""
        self.last_stamp = -float("inf")
        """Stamp of the row taken last [s]."""
        self._waiting: Deque[RecorderRow] = collections.deque()
        self._file = open(path, "x", newline="")  # noqa: SIM115  (closed by its thread)
        self._file.write(",".join(COLUMNS) + "\n")
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def put(self, row: RecorderRow, now: float) -> None:
        """Takes a row at the time `now` [s]; it never waits."""
        in_order = self.last_stamp < row.reading.stamp <= now + FUTURE
        if not in_order or not row.finite:
            self.left_out += 1
            return
        if len(self._waiting) >= MOST_WAITING:
            self.error = f"{self.path}: the disk is {MOST_WAITING} rows behind"
            return
        self.last_stamp = row.reading.stamp
        self._waiting.append(row)
        self.rows += 1

    def close(self) -> None:
        """Brings all rows to the disk."""
        self._closing.set()
        self._thread.join(LONGEST_CLOSE)
        if self._thread.is_alive():
            self.error = f"{self.path}: the disk has not answered for {LONGEST_CLOSE:g} s"

    def _run(self) -> None:
        try:
            _sync_folder(self.path)
            over, passed = False, 0.0
            while not over:
                over = self._closing.wait(WRITE_PERIOD)
                passed += WRITE_PERIOD
                self._write()
                if over or passed >= SYNC_PERIOD:
                    os.fsync(self._file.fileno())
                    passed = 0.0
        except Exception as error:  # a recording that ends without a word is none
            self.error = f"{self.path}: {error}"
        with contextlib.suppress(OSError):  # what a full disk did not take is said by `error`
            self._file.close()

    def _write(self) -> None:
        lines = []
        while self._waiting:
            lines.append(self._waiting.popleft().line(self.origin))
        self._file.write("".join(lines))
        self._file.flush()


def new_recording(folder: str, name: str = "drive") -> Tuple[str, int]:
    """The first of NAME_00.csv, NAME_01.csv, ... in a folder that does not exist, and its number.

    A drive after a crash so begins a new file, and the one that was cut off stays as it is.
    """
    os.makedirs(folder, exist_ok=True)
    number = 0
    while os.path.exists(os.path.join(folder, f"{name}_{number:02d}.csv")):
        number += 1
    return os.path.join(folder, f"{name}_{number:02d}.csv"), number


def _sync_folder(path: str) -> None:
    """Brings the name of a new file to the disk."""
    folder = os.open(os.path.dirname(os.path.abspath(path)), os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
