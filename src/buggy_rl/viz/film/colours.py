"""Colours of films, distinct also to the colour-blind; what they mean is told by shape too."""

from buggy_rl.viz.style import COLOURS

RGB = tuple[float, float, float]


def rgb(colour: str) -> RGB:
    """Red, green, blue in 0..1 of #rrggbb."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return red, green, blue


def pixel(colour: RGB) -> tuple[int, int, int]:
    """The same in 0..255."""
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
    """Between two colours: the other for `share` 1."""
    red, green, blue = ((1 - share) * a + share * b for a, b in zip(one, other, strict=True))
    return red, green, blue
