"""A film in the browser: play, pause, seek, speed and camera in viser's panel."""

import time
from collections.abc import Callable
from dataclasses import replace
from html import escape

from buggy_rl.visual.film.camera import CAMERAS
from buggy_rl.visual.film.canvas import CAR, GHOSTS, RGB, pixel
from buggy_rl.visual.film.director import Director
from buggy_rl.visual.film.shot import Shot, ShownCar
from buggy_rl.visual.viewer.stage import Stage, address, make_server

ROW = '<div style="display:flex;gap:.6em;align-items:center;margin:.25em 0">{}</div>'
SCALE = (
    '<div style="position:relative;flex:1;height:.6em;background:#8886;border-radius:3px">{}</div>'
)


def instruments(shot: Shot) -> str:
    """What the inset of a film shows: names and speeds, drive, and steering to the left."""
    cars = zip(shot.cars, (CAR, *GHOSTS), strict=False)
    names = [_name(car, colour) for car, colour in cars]
    drive = (shot.car.throttle + 1) / 2
    half = max(-1.0, min(1.0, shot.car.steering)) / 2
    rows = [
        *names,
        ROW.format(f"drive {_bar(0.0, drive)} {drive:.2f}"),
        # Positive steering, to the left, fills to the left of the middle.
        ROW.format(f"steering {_bar(0.5 - max(half, 0), 0.5 + max(-half, 0))} {2 * half:+.2f}"),
    ]
    return f'<div style="padding:.2em .9em;font-size:.85em">{"".join(rows)}</div>'


def _name(car: ShownCar, colour: RGB) -> str:
    dot = f'<span style="color:rgb{pixel(colour)}">●</span>'
    return ROW.format(f'{dot} {escape(car.name)} <b style="flex:1;text-align:right">'
                      f"{car.speed:.2f} m/s</b>")  # fmt: skip


def _bar(low: float, high: float) -> str:
    """A scale from 0 to 1, filled between two values."""
    style = f"left:{100 * low:.1f}%;width:{100 * (high - low):.1f}%"
    filled = f'<div style="position:absolute;{style};height:100%;background:rgb{pixel(CAR)}"></div>'
    return SCALE.format(filled)


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
