"""Colours, labels and axes of all figures, and figures as SVG; the Agg backend opens no window."""

import html
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

matplotlib.use("Agg")

PRINTED = 130  # [dots per inch] of a png
MEASURED_COLOUR = "#222222"
FAINT = "#9a9a9a"
COLOURS = ("#d1495b", "#00798c", "#edae49", "#66a182", "#6a47d1", "#2e4057")
INPUT_LABELS = ("vx [m/s]", "vy [m/s]", "yaw rate [rad/s]", "throttle [-]", "steering [-]")


def tidy(axis: Axes) -> None:
    """Draws a faint grid, and a frame on two sides only."""
    axis.grid(alpha=0.25)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)


def write_figure(figure: Figure, stem: str | Path) -> list[Path]:
    """Writes a figure as STEM.svg and STEM.png, with its folder."""
    stem = Path(stem)
    stem.parent.mkdir(parents=True, exist_ok=True)
    files = [stem.with_name(f"{stem.name}.{ending}") for ending in ("svg", "png")]
    for file in files:
        figure.savefig(file, dpi=PRINTED)
    return files


def save_figure(figure: Figure, file: str | Path, dpi: int = 120) -> None:
    """Writes a figure, with its folder, and prints where it is."""
    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=dpi)
    print(f"written: {file}")


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
