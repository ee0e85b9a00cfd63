"""The process that renders; nothing here imports MuJoCo before it runs there."""

from collections.abc import Sequence
from multiprocessing.connection import Connection


def work(connection: Connection, alphas: Sequence[float], size: tuple[int, int]) -> None:
    """Draws the (shot, view) pairs that come through a connection, until it is closed."""
    from buggy_rl.viz.film.renderer import Renderer

    renderer = Renderer(alphas, size)
    while True:
        try:
            connection.send(renderer.frame(*connection.recv()))
        except (EOFError, BrokenPipeError):
            return
