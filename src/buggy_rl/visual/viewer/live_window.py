"""The 3D view of a drive that goes on, in a process of its own."""

import multiprocessing
import queue
import time
from collections import deque
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.director import TRAIL, Director
from buggy_rl.visual.film.shot import Shot
from buggy_rl.visual.film.track import PathLine, Track

KEPT = 2 * TRAIL  # [s] of the past that shots are made of

LiveRow = tuple[float, tuple[float, ...], int]
"""Time [s]; pose, velocity, action [8]; index of the next waypoint."""


class LiveTrack:
    """Collects rows; wheels roll on from where they were when old rows are forgotten.

    Args:
        name: Of the car.
        course: That is followed.
        dimensions: Of the car.
    """

    def __init__(
        self, name: str, course: PathLine | None, dimensions: VehicleDimensions | None = None
    ) -> None:
        self._name, self._course = name, course
        self._dimensions = dimensions or VehicleDimensions()
        self._rows: deque[LiveRow] = deque()
        self._rolled = np.zeros(4)  # [rad] of the wheels up to the oldest row kept

    def add(self, row: LiveRow) -> None:
        """Takes the next row.

        Raises:
            ValueError: It is not later than the one before.
        """
        if self._rows and row[0] <= self._rows[-1][0]:
            raise ValueError(f"row at {row[0]:g} s after one at {self._rows[-1][0]:g} s")
        self._rows.append(row)
        while self._rows[-1][0] - self._rows[0][0] > KEPT:
            first = self._rows.popleft()
            self._rolled += self._between(first, self._rows[0])

    def shot(self, camera: str) -> Shot | None:
        """What is seen at the last row; None before there are two."""
        if len(self._rows) < 2:
            return None
        time, values, following = zip(*self._rows, strict=True)
        begin = np.array(time) - time[0]
        motion = np.array(values)
        track = Track(
            self._name, begin, motion[:, :3], motion[:, 3:6], motion[:, 6:],
            self._course, np.array(following),
        )  # fmt: skip
        shot = Director([track], camera, dimensions=self._dimensions).shot(track.duration)
        shot.car.roll[:] += self._rolled
        return shot

    def _between(self, one: LiveRow, other: LiveRow) -> np.ndarray:
        """Angles by which the wheels roll from one row to the next [4]."""
        time = np.array([one[0], other[0]])
        motion = np.array([one[1], other[1]])
        angle = wheels.steering_angle(motion[:, 7])
        return wheels.rolled(time, motion[:, 3:6], angle, self._dimensions)[-1]


PERIOD = 1 / 30  # [s] between two frames
WAITING = 200  # rows on their way; further ones are not shown, none is waited for
STARTING = 60.0  # [s] until the process must have said where it serves


class LiveWindow:
    """Shows rows; what it is given returns at once, so that drawing delays no step.

    Args:
        name: Of the car.
        course: That is followed.
        camera: `chase` or `top`.

    Raises:
        RuntimeError: The process did not start.
    """

    def __init__(self, name: str, course: PathLine | None, camera: str = "chase") -> None:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        self._rows: Any = context.Queue(WAITING)
        arguments = (theirs, self._rows, name, course, camera)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        theirs.close()
        try:
            if not ours.poll(STARTING):
                raise RuntimeError(f"the 3D view did not start within {STARTING:g} s: view=false")
            self.url: str = ours.recv()
        except (EOFError, RuntimeError) as error:
            self.close()
            raise RuntimeError(f"the 3D view ended at its start: {error}") from error

    def show(self, row: LiveRow) -> None:
        """Gives a row to the window; when too many wait, this one is not shown."""
        self._put(("row", row))

    def look(self, camera: str) -> None:
        """Changes the camera."""
        self._put(("camera", camera))

    def close(self) -> None:
        """Ends the process."""
        self._rows.cancel_join_thread()
        self._process.terminate()
        self._process.join(5)

    def _put(self, message: tuple[str, Any]) -> None:
        with suppress(queue.Full):  # the picture is behind; the drive is what must not be
            self._rows.put_nowait(message)


def _serve(where: Connection, rows: Any, name: str, course: PathLine | None, camera: str) -> None:
    """Serves the window until it is terminated; ends when who drives has ended."""
    import signal

    from buggy_rl.visual.viewer.stage import Stage, address, make_server

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the drive, which ends this
    parent = multiprocessing.parent_process()
    server = make_server("drive")
    server.gui.main_panel.minimize()  # there is nothing in it for a driver
    stage = Stage(server, VehicleDimensions())
    track = LiveTrack(name, course)
    where.send(address(server))
    while parent is None or parent.is_alive():
        begin = time.monotonic()
        camera = _take(rows, track, camera)
        shot = track.shot(camera)
        if shot is not None:
            stage.show(shot)
        time.sleep(max(0.0, PERIOD - (time.monotonic() - begin)))


def _take(rows: Any, track: LiveTrack, camera: str) -> str:
    """Adds the rows that wait; returns the camera last asked for."""
    while True:
        try:
            kind, content = rows.get_nowait()
        except queue.Empty:
            return camera
        if kind == "camera":
            camera = content
        else:
            track.add(content)
