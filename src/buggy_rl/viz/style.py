"""Colours, labels and axes of all figures; the Agg backend opens no window."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
from matplotlib.axes import Axes
from matplotlib.figure import Figure

PRINTED = 130  # [dots per inch] of a png
MEASURED = "#222222"
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
