"""The page that a person drives with, and the WebSocket that its keys and sticks come by."""

import asyncio
import json
import socket
import threading
from collections.abc import Callable
from http import HTTPStatus
from importlib.resources import files
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.typing import Origin

from buggy_rl.car.human import Controls, HumanInput, read_controls
from buggy_rl.core.extras import needs
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.options import Live

HOST = "127.0.0.1"  # nothing outside this machine reaches the page
TOLD = 0.05  # [s] between two messages to the page
UNSUPPORTED, BUSY = 1003, 1013  # WebSocket close codes of RFC 6455 and its registry


class ControlPage:
    """Serves the page on this machine, and hears what it sends.

    One page drives at a time; a second one is sent away. Another website that the browser has open
    is refused by its origin.

    Args:
        heard: Takes the controls.
        scene: Address that the page shows in its frame; empty for none.
        port: 0 takes a free one.
        look: Takes the camera that the page asks for.

    Raises:
        ValueError: The port is taken.
    """

    def __init__(
        self,
        heard: HumanInput,
        scene: str = "",
        port: int = 0,
        look: Callable[[str], None] = lambda camera: None,
    ) -> None:
        self._heard, self._look = heard, look
        try:
            self._socket = socket.create_server((HOST, port))
        except OSError as error:
            raise ValueError(f"port={port}: {error.strerror}; port=0 takes a free one") from None
        self.port: int = self._socket.getsockname()[1]
        self.url = f"http://{HOST}:{self.port}/"
        self._page = _page(scene)
        self._driver: ServerConnection | None = None
        self._status: dict[str, Any] = {"phase": "waiting"}
        self.started = threading.Event()
        """Set when the page asks to start."""
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        self._ready.wait()

    def tell(self, **status: Any) -> None:
        """What the page shows from now on: phase, time, speed, ..."""
        self._status = status

    def close(self) -> None:
        """Closes the port."""
        self._loop.call_soon_threadsafe(self._ended.set)
        self._thread.join(5)

    def _run(self) -> None:
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        here = [Origin(f"http://{name}:{self.port}") for name in (HOST, "localhost")]
        server = serve(
            self._converse,
            sock=self._socket,
            process_request=self._answer,
            origins=[*here, None],  # None: a program, which no website can pretend to be
            compression=None,
        )
        async with server:
            self._ready.set()
            await self._ended.wait()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page; None lets a WebSocket through."""
        path = request.path.partition("?")[0]
        if path == "/controls":
            return None
        if path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, f"there is no {path} here\n")
        headers = Headers({
            "Content-Type": "text/html; charset=utf-8",
            "Content-Length": str(len(self._page)),
            "Cache-Control": "no-store",
            "Connection": "close",
        })  # fmt: skip
        return Response(HTTPStatus.OK, "OK", headers, self._page)

    async def _converse(self, connection: ServerConnection) -> None:
        if self._driver is not None:
            return await connection.close(BUSY, "another page drives: close it first")
        self._driver = connection
        teller = asyncio.create_task(self._keep_telling(connection))
        try:
            async for message in connection:
                self._hear(message)
        except ConnectionClosed:
            pass  # a browser that went away; the finally clause says so
        except (ValueError, TypeError) as error:
            await connection.close(UNSUPPORTED, str(error)[:100])
        finally:
            self._heard.hear(Controls(connected=False))
            self._driver = None
            teller.cancel()

    def _hear(self, message: str | bytes) -> None:
        content = json.loads(message)
        if content == {"start": True}:
            self.started.set()
        elif isinstance(content, dict) and content.get("camera") in ("chase", "top"):
            self._look(content["camera"])
        else:
            self._heard.hear(read_controls(message))

    async def _keep_telling(self, connection: ServerConnection) -> None:
        try:
            while True:
                await connection.send(json.dumps(self._status))
                await asyncio.sleep(TOLD)
        except ConnectionClosed:
            pass  # who reads from it notices too


def _page(scene: str) -> bytes:
    text = files("buggy_rl.visual.viewer").joinpath("control_page.html").read_text("utf-8")
    return text.replace("{{scene}}", scene or "about:blank").encode()


def play(director: Director, playback: float = 1.0, where: Live = True) -> None:
    """Plays until it is ended.

    Args:
        director: Of one or two tracks.
        playback: Seconds of driving in a second.
        where: `window`, `browser`, or True for the window where there is a screen.

    Raises:
        ValueError: There is no screen for a window.
    """
    if shown_in(where) == "window":
        from buggy_rl.visual.film import live

        return live.play(director, playback)
    needs("viser", "visual", "a film in the browser")
    from buggy_rl.visual.viewer import film_player

    film_player.play(director, playback)


def shown_in(where: Live) -> str:
    """`window` or `browser`."""
    from buggy_rl.visual.film.live import has_screen

    if where is True:
        return "window" if has_screen() else "browser"
    return str(where)
