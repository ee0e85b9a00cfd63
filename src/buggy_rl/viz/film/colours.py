"""Colours of films: those of the figures, so that one thing has one colour everywhere."""

from matplotlib.colors import to_rgb

from buggy_rl.viz.style import COLOURS

Colour = tuple[float, float, float]
"""r, g, b in 0..1."""


def rgb(colour: str | Colour) -> Colour:
    """A colour by its name, as #rrggbb or as numbers."""
    red, green, blue = to_rgb(colour)
    return red, green, blue


CAR, GHOST = rgb(COLOURS[0]), rgb(COLOURS[1])
PATH, OPEN, CLOSED = rgb("#2e4057"), rgb(COLOURS[2]), rgb(COLOURS[3])
INK, PAPER = rgb("#1b1f24"), rgb("#f4f5f6")
