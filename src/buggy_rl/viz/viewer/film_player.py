"""A film in the browser: play, pause, seek, speed and camera in viser's panel."""

import time
from collections.abc import Callable
from dataclasses import replace

from buggy_rl.viz.film.camera import CAMERAS
from buggy_rl.viz.film.director import Director
from buggy_rl.viz.viewer.instruments import instruments
from buggy_rl.viz.viewer.stage import Stage, address, make_server

PERIOD = 1 / 25  # [s] between two frames
FREE = "free"  # the mouse's camera
SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "4")


class FilmPlayer:
    """Serves a director's film on this machine.

    Args:
        director: Of one or two tracks.
        playback: Seconds of driving in a second, to begin with.
    """

    def __init__(self, director: Director, playback: float = 1.0) -> None:
        self._directors = {name: replace(director, camera=name) for name in CAMERAS}
        self._server = make_server("buggy_rl")
        self._stage = Stage(self._server, director.dimensions, ghosts=len(director.tracks) - 1)
        self.url = address(self._server)
        self.duration = director.tracks[0].duration
        gui = self._server.gui
        self.playing = gui.add_checkbox("play", True)
        self.seek = gui.add_slider("time [s]", 0.0, self.duration, 0.01, 0.0)
        speeds = SPEEDS if f"{playback:g}" in SPEEDS else (*SPEEDS, f"{playback:g}")
        self.speed = gui.add_dropdown("speed", speeds, initial_value=f"{playback:g}")
        self.camera = gui.add_dropdown("camera", (*CAMERAS, FREE), initial_value=director.camera)
        self._panel = gui.add_html("")
        self._shown: tuple[float, str, int] | None = None

    def advance(self, seconds: float) -> None:
        """Shows the film `seconds` of the clock later; from the beginning again at the end."""
        now = float(self.seek.value)
        if self.playing.value:
            now = (now + seconds * float(self.speed.value)) % self.duration
            self.seek.value = round(now, 4)
        camera = str(self.camera.value)
        clients = self._server.get_clients()
        if self._shown == (now, camera, len(clients)):
            return  # a pause: the panel stays as it is
        self._shown = now, camera, len(clients)
        shot = self._directors["chase" if camera == FREE else camera].shot(now)
        self._stage.show(shot, free=list(clients) if camera == FREE else ())
        self._panel.content = instruments(shot)

    def play(self, going: Callable[[], bool] = lambda: True) -> None:
        """Plays while `going`, in real time."""
        before = time.monotonic()
        while going():
            time.sleep(PERIOD)
            now = time.monotonic()
            self.advance(now - before)
            before = now

    def stop(self) -> None:
        """Closes the port."""
        self._server.stop()


def play(director: Director, playback: float = 1.0) -> None:
    """Prints the address and plays until Ctrl-C."""
    player = FilmPlayer(director, playback)
    print(f"the film is at {player.url} (on this machine only); Ctrl-C ends it", flush=True)
    try:
        player.play()
    except KeyboardInterrupt:
        print("ended")
    finally:
        player.stop()
