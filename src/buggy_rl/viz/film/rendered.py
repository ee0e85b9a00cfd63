"""Frames by MuJoCo's renderer, in a process of its own.

MuJoCo chooses its OpenGL when it is first imported; a simulator may have imported it long before.
"""

import multiprocessing
import os
from collections.abc import Sequence
from typing import Self

from numpy.typing import NDArray

from buggy_rl.viz.film.cameras import View
from buggy_rl.viz.film.gl import backend
from buggy_rl.viz.film.shot import Shot


class Rendered:
    """Draws shots; a context manager, whose end ends the process.

    Args:
        alphas: Opacity of each car.
        size: Width and height of the frames [pixels].
    """

    def __init__(self, alphas: Sequence[float], size: tuple[int, int]) -> None:
        from buggy_rl.viz.film.worker import work

        before = os.environ.get("MUJOCO_GL")
        os.environ["MUJOCO_GL"] = backend()
        context = multiprocessing.get_context("spawn")
        self._connection, other = context.Pipe()
        self._process = context.Process(target=work, args=(other, alphas, size), daemon=True)
        try:
            self._process.start()
        finally:
            del os.environ["MUJOCO_GL"]
            if before is not None:
                os.environ["MUJOCO_GL"] = before
        other.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def frame(self, shot: Shot, view: View) -> NDArray:
        """[H, W, 3] uint8.

        Raises:
            RuntimeError: The process has ended; its own words are on the terminal.
        """
        self._connection.send((shot, view))
        try:
            return self._connection.recv()
        except EOFError as error:
            raise RuntimeError(
                "MuJoCo's renderer ended: its own words are above; renderer=drawn does without it"
            ) from error

    def close(self) -> None:
        """Ends the process."""
        self._connection.close()
        self._process.join(5.0)
        self._process.kill()
