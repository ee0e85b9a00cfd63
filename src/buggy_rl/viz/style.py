"""What all pictures have in common: colours, labels, quiet axes, no window."""

import matplotlib

matplotlib.use("Agg")
from matplotlib.axes import Axes

MEASURED = "#222222"
FAINT = "#9a9a9a"
COLOURS = ("#d1495b", "#00798c", "#edae49", "#66a182", "#8d6a9f", "#2e4057")
INPUT_LABELS = ("vx [m/s]", "vy [m/s]", "yaw rate [rad/s]", "throttle [-]", "steering [-]")


def tidy(axis: Axes) -> None:
    """A faint grid, and a frame on two sides only."""
    axis.grid(alpha=0.25)
    axis.set_axisbelow(True)
    axis.spines[["top", "right"]].set_visible(False)
