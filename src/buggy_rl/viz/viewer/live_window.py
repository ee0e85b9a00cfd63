"""The 3D view of a drive that goes on, in a process of its own."""

import multiprocessing
import queue
import time
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film.track import Course
from buggy_rl.viz.viewer.live_track import LiveRow, LiveTrack

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

    def __init__(self, name: str, course: Course | None, camera: str = "chase") -> None:
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


def _serve(where: Connection, rows: Any, name: str, course: Course | None, camera: str) -> None:
    """Serves the window until it is terminated; ends when who drives has ended."""
    import signal

    from buggy_rl.viz.viewer.stage import Stage, address, make_server

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
