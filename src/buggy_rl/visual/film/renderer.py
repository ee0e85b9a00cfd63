"""Renders shots to pixels: MuJoCo in a process of its own, or a drawing from above."""

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import gl
from buggy_rl.visual.film.drawing import Drawing
from buggy_rl.visual.film.shot import Frame, Shot

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
        self._process = gl.WorkerProcess(backend)
        try:
            self._process.ask((self._scene.binary(), size))
        except gl.WorkerError:
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
    found = gl.probe()
    if found.backend is not None:
        return MujocoRenderer(found.backend, dimensions, size, ghosts, samples)
    why = f"MuJoCo cannot render here ({found.reason})"
    if choice == "mujoco":
        raise ValueError(f"{why}: {gl.REMEDY}, or take renderer=drawing")
    return Drawing(dimensions, size, f"{why}: drawn from above instead; to see it, {gl.REMEDY}")
