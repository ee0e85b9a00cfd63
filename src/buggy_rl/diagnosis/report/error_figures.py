"""Pictures of where a simulator errs: over the floor of the room, over speed and steering."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from buggy_rl.diagnosis.report.errors import Errors
from buggy_rl.diagnosis.report.style import ERROR, tidy

SIZE = 4.6, 3.9  # [inch]
CELLS = 9, 8  # of steering and of speed
FEW = 3  # instants below which a cell says nothing
BRIGHTEST = 0.97  # share of the errors at which the colours end: one spin must not dim the rest
LABEL = "error [times the sensor's noise]"


def map_figure(errors: Errors) -> Figure:
    """Each instant a dot where the car was, the worst on top."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axis = figure.subplots()
    order = errors.size.argsort(kind="stable")
    dots = axis.scatter(
        errors.x[order],
        errors.y[order],
        c=errors.size[order],
        s=13,
        lw=0.25,
        edgecolors="#00000030",
        cmap=ERROR,
        norm=_scale(errors.size),
        rasterized=True,
    )
    axis.set(xlabel="x [m]", ylabel="y [m]")
    axis.set_aspect("equal", adjustable="datalim")
    tidy(axis)
    figure.colorbar(dots, ax=axis, label=LABEL, shrink=0.85, extend="max")
    return figure


def situation_figure(errors: Errors) -> Figure:
    """Root mean square error in cells of steering and speed; hatched where nobody drove."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axis = figure.subplots()
    steering = np.linspace(-1, 1, CELLS[0] + 1)
    speed = np.linspace(min(0.0, errors.vx.min()), max(errors.vx.max(), 0.5), CELLS[1] + 1)
    bins = [steering, speed]
    count, *_ = np.histogram2d(errors.steering, errors.vx, bins)
    total, *_ = np.histogram2d(errors.steering, errors.vx, bins, weights=errors.size**2)
    mean = np.sqrt(total / np.maximum(count, 1))
    mean[count < FEW] = np.nan
    shown = mean[np.isfinite(mean)]
    axis.patch.set(hatch="////", facecolor="#f6f4f0", edgecolor="#d9d4ca")
    cells = axis.pcolormesh(
        steering, speed, mean.T, cmap=ERROR, norm=_scale(shown), edgecolors="white", lw=0.6
    )
    _framed(axis)
    figure.colorbar(cells, ax=axis, label=LABEL, shrink=0.85, extend="max")
    return figure


def _framed(axis: Axes) -> None:
    axis.set(
        xlabel="steering [-]  (right below 0, left above)",
        ylabel="speed vx [m/s]",
        xticks=np.linspace(-1, 1, 5),
    )
    axis.spines[["top", "right"]].set_visible(False)


def _scale(size: np.ndarray) -> Normalize:
    """From none to what all but the very worst are; noise alone is 1."""
    most = float(np.quantile(size, BRIGHTEST)) if len(size) else 0.0
    return Normalize(0.0, max(most, 2.0))
