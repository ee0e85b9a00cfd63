"""The corner of a film: time, speed, commands, and which car is which."""

from dataclasses import dataclass

import numpy as np
from PIL import Image

from buggy_rl.viz.film.canvas import CENTRE, LEFT, RIGHT, Canvas, text_width
from buggy_rl.viz.film.colours import CAR, GHOSTS, RGB, mixed
from buggy_rl.viz.film.shot import Car, Frame, Shot

PANEL, TRACK = (0.07, 0.08, 0.10), (0.30, 0.32, 0.35)
TEXT, FAINT = (0.97, 0.97, 0.97), (0.72, 0.74, 0.77)
ALPHA = 0.72
WHITE = (1.0, 1.0, 1.0)
UNIT = 480  # [pixel] height of the picture for which the lengths below are meant
WIDTH, EDGE, ROW = 196.0, 12.0, 21.0
BAR = 74.0, 158.0  # from x to x: the scale of a command


@dataclass(frozen=True)
class Inset:
    """Draws on frames.

    Args:
        title: Above the names; empty for none.
    """

    title: str = ""

    def on(self, frame: Frame, shot: Shot) -> Frame:
        """The frame [H, W, 3] with the panel in its lower left corner."""
        unit = frame.shape[0] / UNIT
        cars = list(zip(shot.cars, _lit(), strict=False))
        height = EDGE + ROW * (len(cars) + 2) + (ROW if self.title else 0) + 0.5 * EDGE
        canvas = Canvas((round(WIDTH * unit), round(height * unit)), PANEL, 0.0)
        pen = Pen(canvas, unit)
        pen.panel(height)
        row = 1.05 * ROW
        if self.title:
            pen.text(EDGE, row, self.title, FAINT)
            row += ROW
        for car, colour in cars:
            pen.name(row, car, colour)
            row += ROW
        for name, value, low in (
            ("drive", (shot.car.throttle + 1) / 2, 0.0),
            ("steering", -shot.car.steering, -1.0),
        ):
            pen.bar(row, name, value, low)
            row += ROW
        clock = f"{shot.time:.1f} s"
        return _pasted(frame, canvas, unit, clock)


class Pen:
    """Draws the panel's rows in its own unit of length."""

    def __init__(self, canvas: Canvas, unit: float) -> None:
        self._canvas, self._unit = canvas, unit

    def panel(self, height: float) -> None:
        """The dark ground."""
        unit = self._unit
        self._canvas.box((0, 0, WIDTH * unit - 1, height * unit - 1), 7 * unit, PANEL, ALPHA)

    def text(self, x: float, y: float, text: str, colour: RGB, anchor: str = LEFT) -> None:
        """One line."""
        self._canvas.text((x * self._unit, y * self._unit), text, 13 * self._unit, colour, anchor)

    def name(self, y: float, car: Car, colour: RGB) -> None:
        """A car's colour, name and speed."""
        unit = self._unit
        self._canvas.disc(((EDGE + 4) * unit, (y - 5) * unit), 5 * unit, colour)
        self.text(EDGE + 15, y, _shortened(car.name, 96.0), TEXT)
        self.text(WIDTH - EDGE, y, f"{car.speed:.2f} m/s", TEXT, RIGHT)

    def bar(self, y: float, name: str, value: float, low: float) -> None:
        """A command on its scale from `low` to 1, filled from 0; positive to the right."""
        unit = self._unit
        self.text(EDGE, y, name, FAINT)
        left, right = BAR[0], WIDTH - EDGE
        zero = left + (right - left) * (0 - low) / (1 - low)
        end = left + (right - left) * (float(np.clip(value, low, 1.0)) - low) / (1 - low)
        top, foot = (y - 9) * unit, (y - 1) * unit
        self._canvas.box((left * unit, top, right * unit, foot), 3 * unit, TRACK)
        first, last = sorted((zero, end))
        self._canvas.box(
            (first * unit, top, max(last, first + 1) * unit, foot), 2 * unit, _lit()[0]
        )
        if low < 0:
            middle = ((zero - 0.6) * unit, top - unit, (zero + 0.6) * unit, foot + unit)
            self._canvas.box(middle, 0, TEXT)


def captioned(frame: Frame, text: str) -> Frame:
    """The frame [H, W, 3] with a line of text at its top; as it is without one."""
    if not text:
        return frame
    image, unit = Image.fromarray(frame), frame.shape[0] / UNIT
    wide = min(text_width(text, 17 * unit) + 2 * EDGE * unit, image.width)
    canvas = Canvas((round(wide), round(30 * unit)), PANEL, 0.0)
    canvas.box((0, 0, wide - 1, 30 * unit - 1), 7 * unit, PANEL, ALPHA)
    canvas.text((wide / 2, 20.5 * unit), text, 17 * unit, TEXT, CENTRE)
    line = canvas.reduced()
    image.paste(line, ((image.width - line.width) // 2, round(EDGE * unit)), line)
    return np.asarray(image)


def _lit() -> list[RGB]:
    """The cars' colours, as they stand out on the dark panel."""
    return [mixed(CAR, WHITE, 0.12), *(mixed(ghost, WHITE, 0.3) for ghost in GHOSTS)]


def _shortened(name: str, width: float) -> str:
    """A name that fits, ended by an ellipsis if it had to be cut."""
    if text_width(name, 13) <= width:
        return name
    while name and text_width(name + "…", 13) > width:
        name = name[:-1]
    return name + "…"


def _pasted(frame: Frame, canvas: Canvas, unit: float, clock: str) -> Frame:
    """The panel in the lower left corner, the time in the upper right one."""
    image = Image.fromarray(frame)
    margin = round(EDGE * unit)
    panel = canvas.reduced()
    image.paste(panel, (margin, image.height - margin - panel.height), panel)
    width = round(58 * unit)
    corner = Canvas((width, round(24 * unit)), PANEL, 0.0)
    corner.box((0, 0, width - 1, 24 * unit - 1), 7 * unit, PANEL, ALPHA)
    corner.text((width - 9 * unit, 16.5 * unit), clock, 13 * unit, TEXT, RIGHT)
    small = corner.reduced()
    image.paste(small, (image.width - margin - width, margin), small)
    return np.asarray(image)
