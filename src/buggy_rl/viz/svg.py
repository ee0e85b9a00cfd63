"""Figures as SVG elements of an HTML page."""

import html
import io
import re
from collections.abc import Callable
from typing import Any, TypeVar

import matplotlib
from matplotlib.figure import Figure

RASTER = 200  # [dots per inch] of what has too many points for a vector drawing
SETTINGS: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: small, and found by a search in the page
    "svg.hashsalt": "buggy_rl",  # equal figures have equal ids
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.edgecolor": "#777777",
    "grid.linewidth": 0.6,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
}

Data = TypeVar("Data")


def svg(draw: Callable[[Data], Figure], data: Data, words: str) -> str:
    """An SVG element that refers to nothing outside the page and takes the page's width.

    `words` describe it to screen readers.
    """
    stream = io.StringIO()
    with matplotlib.rc_context(SETTINGS):
        draw(data).savefig(stream, format="svg", dpi=RASTER, metadata={"Date": None})
    text = stream.getvalue()
    text = re.sub(r"<(metadata|style)\b.*?</\1>", "", text[text.index("<svg") :], flags=re.DOTALL)
    opening, rest = text.split(">", 1)
    opening = re.sub(r'\s(xmlns(:xlink)?|width|height|version)="[^"]*"', "", opening)
    return f'{opening} role="img" aria-label="{html.escape(words)}">{rest}'
