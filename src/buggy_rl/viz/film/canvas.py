"""Anti-aliased drawing on an image: everything is drawn larger, then reduced."""

from collections.abc import Sequence
from functools import cache
from typing import cast

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from buggy_rl.viz.film.colours import RGB, pixel

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
        """In the size of the result."""
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
