"""Anti-aliased drawing on an image, colours of films, and the inset of numbers."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import cast

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from buggy_rl.figures.style import COLOURS
from buggy_rl.visual.film.shot import Frame, Shot, ShownCar

RGB = tuple[float, float, float]


def rgb(colour: str) -> RGB:
    """Red, green, blue in 0..1 of #rrggbb."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue


def pixel(colour: RGB) -> tuple[int, int, int]:
    """Pixel of a colour, each part in 0..255."""
    red, green, blue = (round(255 * part) for part in colour)
    return red, green, blue


CAR, *GHOSTS = rgb(COLOURS[0]), rgb(COLOURS[1]), rgb(COLOURS[2])
MOST_GHOSTS = len(GHOSTS)
OPEN, CLOSED = rgb(COLOURS[2]), rgb(COLOURS[3])
AHEAD = (0.96, 0.95, 0.92)
FLOOR, GRID, SKY = (0.56, 0.58, 0.61), (0.44, 0.47, 0.50), (0.88, 0.91, 0.94)
GHOST_ALPHA = 0.42
GHOST_TINT = 0.55  # share of its paint in the colour of every part of the ghost


def mixed(one: RGB, other: RGB, share: float) -> RGB:
    """Colour between two others: the other for `share` 1."""
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(one, other, strict=True))
    return red, green, blue


LARGER = 2  # times the size of the result, in both directions
LEFT, CENTRE, RIGHT = "ls", "ms", "rs"  # Pillow's anchors, on the baseline


class Canvas:
    """An image of `size` [pixel]; coordinates are pixels of the result, y down.

    Args:
        size: Width and height [pixel].
        background: Red, green, blue, and alpha if it is not 1.
    """

    def __init__(self, size: tuple[int, int], background: RGB, alpha: float = 1.0) -> None:
        mode = "RGB" if alpha == 1.0 else "RGBA"
        fill = _fill(background, alpha) if mode == "RGBA" else pixel(background)
        larger = (LARGER * size[0], LARGER * size[1])
        self.image = Image.new(mode, larger, fill)
        self._draw = ImageDraw.Draw(self.image, "RGBA")

    def polygon(self, points: np.ndarray, colour: RGB, alpha: float = 1.0) -> None:
        """Fills the outline through points [K, 2]."""
        self._draw.polygon(_larger(points), _fill(colour, alpha))

    def line(self, points: np.ndarray, width: float, colour: RGB, alpha: float = 1.0) -> None:
        """Joins points [K, 2]."""
        if len(points) > 1:
            thick = max(1, round(LARGER * width))
            self._draw.line(_larger(points), _fill(colour, alpha), thick, joint="curve")

    def disc(self, centre: Sequence[float], radius: float, colour: RGB, alpha: float = 1.0) -> None:
        """Fills a circle."""
        x, y = (LARGER * part for part in centre)
        r = LARGER * radius
        self._draw.ellipse([x - r, y - r, x + r, y + r], _fill(colour, alpha))

    def box(self, corners: Sequence[float], radius: float, colour: RGB, alpha: float = 1.0) -> None:
        """Fills a rectangle (left, top, right, bottom) with rounded corners."""
        larger = [LARGER * part for part in corners]
        self._draw.rounded_rectangle(larger, LARGER * radius, _fill(colour, alpha))

    def text(
        self, place: Sequence[float], text: str, size: float, colour: RGB, anchor: str = LEFT
    ) -> None:
        """Writes one line on the baseline through `place`."""
        x, y = (LARGER * part for part in place)
        self._draw.text((x, y), text, _fill(colour, 1.0), font(round(LARGER * size)), anchor)

    def reduced(self) -> Image.Image:
        """Image in the size of the result."""
        return self.image.reduce(LARGER)


def text_width(text: str, size: float) -> float:
    """Width of a line of text [pixel of the result]."""
    return font(round(LARGER * size)).getlength(text) / LARGER


@cache
def font(size: int) -> ImageFont.FreeTypeFont:
    """Pillow's own font, so that every machine draws the same."""
    return cast(ImageFont.FreeTypeFont, ImageFont.load_default(size))


def _larger(points: np.ndarray) -> list[tuple[float, float]]:
    return [(x, y) for x, y in (LARGER * np.asarray(points, float)).tolist()]


def _fill(colour: RGB, alpha: float) -> tuple[int, int, int, int]:
    return (*pixel(colour), round(255 * alpha))


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
        """Writes one line."""
        self._canvas.text((x * self._unit, y * self._unit), text, 13 * self._unit, colour, anchor)

    def name(self, y: float, car: ShownCar, colour: RGB) -> None:
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
