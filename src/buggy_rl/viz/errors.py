"""Errors of a simulator over the floor, and over speed and steering."""

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_hex
from matplotlib.figure import Figure

from buggy_rl.viz.style import tidy

SIZE = 4.6, 3.9  # [inch]
CELLS = 9, 8  # of steering and of speed
FEW = 3  # instants below which a cell is left out
BRIGHTEST = 0.97  # quantile of the errors at the end of the colour scale; excludes spins
COLOURS = LinearSegmentedColormap.from_list("error", ["#f3ede6", "#edae49", "#d1495b", "#5c1a33"])
RAMP = [to_hex(COLOURS(share)) for share in np.linspace(0.3, 1.0, 8)]
"""Small errors to large ones as lines on a white page, where the palest would not be seen."""
LABEL = "error [noise standard deviations]"


@dataclass(frozen=True)
class InstantErrors:
    """Standardised velocity errors at M instants."""

    size: np.ndarray
    """[M] change of the velocity residual since the instant before [noise standard deviations]."""
    x: np.ndarray
    """[M] position, world frame [m]."""
    y: np.ndarray
    vx: np.ndarray
    """[M] m/s"""
    steering: np.ndarray
    """[M] command in [-1, 1]."""


def map_figure(errors: InstantErrors) -> Figure:
    """A dot at the position of each instant, the largest errors on top."""
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
        cmap=COLOURS,
        norm=_scale(errors.size),
        rasterized=True,
    )
    axis.set(xlabel="x [m]", ylabel="y [m]")
    axis.set_aspect("equal", adjustable="datalim")
    tidy(axis)
    figure.colorbar(dots, ax=axis, label=LABEL, shrink=0.85, extend="max")
    return figure


def situation_figure(errors: InstantErrors) -> Figure:
    """Root mean square error in cells of steering and speed; hatched where hardly driven."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axis = figure.subplots()
    steering = np.linspace(-1, 1, CELLS[0] + 1)
    speed = np.linspace(min(0.0, errors.vx.min()), max(errors.vx.max(), 0.5), CELLS[1] + 1)
    bins = [steering, speed]
    count, *_ = np.histogram2d(errors.steering, errors.vx, bins)
    total, *_ = np.histogram2d(errors.steering, errors.vx, bins, weights=errors.size**2)
    mean = np.sqrt(total / np.maximum(count, 1))
    mean[count < FEW] = np.nan
    scale = _scale(mean[np.isfinite(mean)])
    axis.patch.set(hatch="////", facecolor="#f6f4f0", edgecolor="#d9d4ca")
    cells = axis.pcolormesh(
        steering, speed, mean.T, cmap=COLOURS, norm=scale, edgecolors="white", lw=0.6
    )
    axis.set(
        xlabel="steering [-]  (right < 0 < left)",
        ylabel="speed vx [m/s]",
        xticks=np.linspace(-1, 1, 5),
    )
    axis.spines[["top", "right"]].set_visible(False)
    figure.colorbar(cells, ax=axis, label=LABEL, shrink=0.85, extend="max")
    return figure


def _scale(size: np.ndarray) -> Normalize:
    """From 0 to the brightest quantile; noise alone is 1."""
    most = float(np.quantile(size, BRIGHTEST)) if len(size) else 0.0
    return Normalize(0.0, max(most, 2.0))
