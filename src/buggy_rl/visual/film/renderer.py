"""Renderer: from shots to pixels, by MuJoCo in a process of its own or drawn from above.

Which OpenGL of MuJoCo works here is tried in such processes, once for this process.
"""

import math
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from threading import Timer
from typing import Any, Protocol

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import worker
from buggy_rl.visual.film.drawing import Drawing
from buggy_rl.visual.film.shot import Frame, Shot

PATIENCE = 60.0  # [s] for a start or a frame; a start takes 3 s alone and 15 s on a busy machine
REMEDY = "install libegl1 and libgl1 (apt-get install -y libegl1 libgl1)"


class WorkerError(RuntimeError):
    """The process that renders failed; the message says how."""


class WorkerProcess:
    """A `worker` under one backend; ends with `close` or the garbage collector.

    Args:
        backend: Value of `MUJOCO_GL`; empty for MuJoCo's own choice.
    """

    def __init__(self, backend: str) -> None:
        self.backend = backend
        environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
        if backend:
            environment["MUJOCO_GL"] = backend
        self._process = subprocess.Popen(
            [sys.executable, "-P", worker.__file__],  # -P: our folder is no place to import from
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout

    def ask(self, content: Any) -> Any:
        """Sends a request and waits for its answer.

        Raises:
            WorkerError: The process failed, ended, or took longer than `PATIENCE`.
        """
        self.send(content)
        return self.receive()

    def send(self, content: Any) -> None:
        """Sends a request.

        Raises:
            WorkerError: The process has ended.
        """
        try:
            worker.send(self._requests, content)
        except OSError as error:
            raise WorkerError(f"{self._named} has ended: {error}") from error

    def receive(self) -> Any:
        """Waits for the answer to the earliest request that has none.

        Raises:
            WorkerError: The process failed, ended, or took longer than `PATIENCE`.
        """
        limit = Timer(PATIENCE, self._process.kill)
        limit.daemon = True
        limit.start()
        try:
            answer = worker.receive(self._answers)
        except EOFError:
            how = "crashed" if limit.is_alive() else f"did not answer within {PATIENCE:g} s"
            raise WorkerError(f"{self._named} {how}") from None
        finally:
            limit.cancel()
        if isinstance(answer, str):
            raise WorkerError(f"{self._named}: {answer}")
        return answer

    def close(self) -> None:
        """Ends the process."""
        for stream in (self._requests, self._answers):
            with suppress(OSError):  # it ended before it read the last request
                stream.close()
        self._process.kill()
        self._process.wait()

    @property
    def _named(self) -> str:
        return f"MUJOCO_GL={self.backend}" if self.backend else "MuJoCo's default OpenGL"


@dataclass(frozen=True)
class Probe:
    """Result of looking for an OpenGL that works."""

    backend: str | None
    """Value of `MUJOCO_GL` that works; None if none does."""
    reason: str
    """Why none does, a clause for each that was tried."""


def gl_backends(environment: dict[str, str], platform: str = sys.platform) -> list[str]:
    """Values of `MUJOCO_GL` to try, in order; one that is set is the only one."""
    if environment.get("MUJOCO_GL"):
        return [environment["MUJOCO_GL"]]
    if not platform.startswith("linux"):
        return [""]
    return ["egl", "osmesa", *(["glfw"] if environment.get("DISPLAY") else [])]


@cache
def probe() -> Probe:
    """Draws an empty scene in a new process under each candidate until one works."""
    failures = []
    for backend in gl_backends(dict(os.environ)):
        process = WorkerProcess(backend)
        try:
            process.ask(None)
            return Probe(backend, "")
        except WorkerError as error:
            failures.append(str(error))
        finally:
            process.close()
    return Probe(None, "; ".join(failures))


RENDERERS = ("auto", "mujoco", "drawing")


class Renderer(Protocol):
    """What makes frames of shots."""

    note: str
    """What the user should know about the choice; empty if nothing."""

    def frames(self, shots: Iterable[Shot]) -> Iterator[Frame]:
        """A frame for each shot, in order."""
        ...

    def close(self) -> None:
        """Ends what it has started."""
        ...


class MujocoRenderer:
    """Renders in another process, one shot ahead of what is asked for.

    Args:
        backend: Value of `MUJOCO_GL`.
        dimensions: Of the cars.
        size: Width and height [pixel].
        ghosts: Number of translucent cars.
        samples: Of each pixel.

    Raises:
        WorkerError: It cannot render.
    """

    note = ""

    def __init__(
        self,
        backend: str,
        dimensions: VehicleDimensions,
        size: tuple[int, int],
        ghosts: int,
        samples: int,
    ) -> None:
        from buggy_rl.visual.film.scene import Scene

        self._dimensions = dimensions
        self._scene = Scene(dimensions, size, ghosts, samples)
        self._process = WorkerProcess(backend)
        try:
            self._process.ask((self._scene.binary(), size))
        except WorkerError:
            self._process.close()
            raise

    def frames(self, shots: Iterable[Shot]) -> Iterator[Frame]:
        """A frame for each shot; the next one is rendered while this one is used."""
        waiting = False
        for shot in shots:
            self._process.send(self._state(shot))
            if waiting:
                yield self._process.receive()
            waiting = True
        if waiting:
            yield self._process.receive()

    def close(self) -> None:
        """Ends the process."""
        self._process.close()

    def _state(self, shot: Shot) -> dict:
        """What `worker.serve` takes."""
        from buggy_rl.visual.film.drawing import marks

        self._scene.place(shot)
        data, view, drawn = self._scene.data, shot.view, marks(shot, self._dimensions)
        return {
            "qpos": data.qpos.copy(),
            "mocap_pos": data.mocap_pos.copy(),
            "mocap_quat": data.mocap_quat.copy(),
            "lookat": (view.x, view.y, view.z),
            "camera": (view.distance, math.degrees(view.azimuth), math.degrees(view.elevation)),
            "marks": (drawn.kind, drawn.size, drawn.position, drawn.yaw, drawn.colour),
        }


@contextmanager
def open_renderer(
    choice: str,
    size: tuple[int, int],
    ghosts: int,
    dimensions: VehicleDimensions | None = None,
    samples: int = 4,
) -> Iterator[Renderer]:
    """A renderer, closed at the end.

    Args:
        choice: mujoco, drawing, or auto for MuJoCo where OpenGL works and else the drawing.
        size: Width and height [pixel].
        ghosts: Number of translucent cars.
        dimensions: Of the cars; None is the buggy.
        samples: Of each pixel, in MuJoCo.

    Raises:
        ValueError: The choice is unknown, the size is odd, or MuJoCo cannot render.
    """
    renderer = make_renderer(choice, size, ghosts, dimensions or VehicleDimensions(), samples)
    try:
        yield renderer
    finally:
        renderer.close()


def make_renderer(
    choice: str, size: tuple[int, int], ghosts: int, dimensions: VehicleDimensions, samples: int = 4
) -> Renderer:
    """Makes a renderer as `open_renderer` does, to be closed by the caller."""
    if choice not in RENDERERS:
        raise ValueError(f"renderer={choice!r}: must be one of {', '.join(RENDERERS)}")
    if min(size) < 64 or any(side % 2 for side in size):
        raise ValueError(f"size={list(size)}: both sides must be even and at least 64 pixels")
    if choice == "drawing":
        return Drawing(dimensions, size)
    found = probe()
    if found.backend is not None:
        return MujocoRenderer(found.backend, dimensions, size, ghosts, samples)
    why = f"MuJoCo cannot render here ({found.reason})"
    if choice == "mujoco":
        raise ValueError(f"{why}: {REMEDY}, or take renderer=drawing")
    return Drawing(dimensions, size, f"{why}: drawn from above instead; to see it, {REMEDY}")
