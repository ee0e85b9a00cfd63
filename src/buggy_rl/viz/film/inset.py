"""What is written over a frame: names, time, commands and speed."""

from functools import cache

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from buggy_rl.viz.film.colours import CAR, CLOSED, GHOST, INK, OPEN, PAPER, Colour
from buggy_rl.viz.film.shot import Shot

REFERENCE = 480  # [pixels] height of a frame at which a unit of the inset is a pixel
WIDTH, HEIGHT, EDGE = 172, 74, 10  # of the panel
FASTEST = 4.0  # [m/s] end of the speed's bar


def with_inset(frame: NDArray, shot: Shot, title: str = "") -> NDArray:
    """A frame [H, W, 3] uint8 with a panel below on the left and names above."""
    image = Image.fromarray(frame)
    unit = frame.shape[0] / REFERENCE
    layer = ImageDraw.Draw(image, "RGBA")
    _names(layer, shot, unit, title)
    _panel(layer, shot, unit, frame.shape[0])
    return np.asarray(image)


def _names(layer: ImageDraw.ImageDraw, shot: Shot, unit: float, title: str) -> None:
    font, y = _font(round(15 * unit)), EDGE * unit
    lines = [(title, INK)] if title else []
    lines += list(zip(shot.names, (CAR, GHOST), strict=False))
    widest = max((layer.textlength(text, font) for text, _ in lines), default=0.0)
    box = [EDGE * unit - 4, y - 4, EDGE * unit + widest + 30 * unit, y + 22 * unit * len(lines)]
    layer.rounded_rectangle(box, 5 * unit, fill=_bytes(PAPER, 215))
    for text, colour in lines:
        x = EDGE * unit + 4
        if text != title:
            layer.rectangle([x, y + 4 * unit, x + 11 * unit, y + 15 * unit], fill=_bytes(colour))
            x += 18 * unit
        layer.text((x, y), text, font=font, fill=_bytes(INK))
        y += 22 * unit


def _panel(layer: ImageDraw.ImageDraw, shot: Shot, unit: float, height: int) -> None:
    row, font = shot.rows[0], _font(round(11 * unit))
    left, top = EDGE * unit, height - (EDGE + HEIGHT) * unit
    box = [left, top, left + WIDTH * unit, top + HEIGHT * unit]
    layer.rounded_rectangle(box, 6 * unit, fill=_bytes(PAPER, 215))
    drive = (row.throttle + 1) / 2
    bars = (
        ("throttle", f"{row.throttle:+.2f}", (0.0, drive), OPEN),
        ("steering", f"{row.steering:+.2f}", (0.5, 0.5 - row.steering / 2), CLOSED),
        ("speed", f"{row.speed:.1f} m/s", (0.0, row.speed / FASTEST), CAR),
    )
    for index, (name, value, ends, colour) in enumerate(bars):
        y = top + (6 + 17 * index) * unit
        layer.text((left + 7 * unit, y), name, font=font, fill=_bytes(INK))
        start, width = left + 56 * unit, 66 * unit
        layer.rectangle([start, y + 3 * unit, start + width, y + 11 * unit], fill=(0, 0, 0, 28))
        low, high = sorted(min(max(e, 0.0), 1.0) for e in ends)
        filled = [start + low * width, y + 3 * unit, start + high * width, y + 11 * unit]
        layer.rectangle(filled, fill=_bytes(colour))
        layer.text((start + width + 5 * unit, y), value, font=font, fill=_bytes(INK))
    below = f"{row.time:.2f} s"
    if shot.waypoints is not None:
        below += f"   {row.closed} waypoints closed"
    layer.text((left + 7 * unit, top + 57 * unit), below, font=font, fill=_bytes(INK))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)


def _bytes(colour: Colour, alpha: int = 255) -> tuple[int, ...]:
    return (*(round(255 * c) for c in colour), alpha)
