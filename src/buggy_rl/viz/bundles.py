"""Bundles of open-loop rollouts over the recording that they start from."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from buggy_rl.viz.style import COLOURS, MEASURED, tidy

HORIZONS = 1.0, 2.0  # [s] of the original study's bundles
QUANTILES = 0.1, 0.5, 0.9
PANEL = 3.3  # [inch]
BEYOND = 0.6  # [m] that a rollout may leave the measured extent by before it is cut off


@dataclass(frozen=True)
class Bundles:
    """N segments of one recording, K instants each."""

    recording: str
    time: NDArray[Any]
    """[K] since the start of each segment [s]."""
    measured: NDArray[Any]
    """[N, K, 3] x, y [m], yaw [rad], world frame."""
    made: Mapping[str, NDArray[Any]]
    """Simulator -> [N, K, 3]."""


def bundles_figure(bundles: Bundles) -> Figure:
    """A column for each simulator: rollouts of 1 s and of 2 s on the floor, then the error."""
    names = list(bundles.made)
    figure = Figure(figsize=(PANEL * len(names), 3.1 * PANEL), layout="constrained")
    axes = figure.subplots(3, len(names), squeeze=False, sharex="row", sharey="row")
    for column, name in enumerate(names):
        colour = COLOURS[column % len(COLOURS)]
        for row, horizon in enumerate(HORIZONS):
            _draw_floor(axes[row, column], bundles, name, horizon, colour)
        _draw_error(axes[2, column], bundles, name, colour)
        axes[0, column].set_title(name, fontsize=10)
        axes[1, column].set_xlabel("x [m]")
        axes[2, column].set_xlabel("time since the start [s]")
    for row, horizon in enumerate(HORIZONS):
        axes[row, 0].set_ylabel(f"rollouts of {horizon:g} s\ny [m]")
    axes[2, 0].set_ylabel("position error [m]\nmedian, 10 to 90 %")
    return figure


def _draw_floor(axis: Axes, bundles: Bundles, name: str, horizon: float, colour: str) -> None:
    kept = bundles.time <= horizon + 1e-9
    for path in bundles.measured[:, kept]:
        axis.plot(*path[:, :2].T, color=MEASURED, lw=2.0, alpha=0.45)
    for path in bundles.made[name][:, kept]:
        axis.plot(*path[:, :2].T, color=colour, lw=1.1)
    points = bundles.measured[..., :2].reshape(-1, 2)
    low, high = points.min(0) - BEYOND, points.max(0) + BEYOND
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axis.set_aspect("equal", adjustable="box")
    tidy(axis)


def _draw_error(axis: Axes, bundles: Bundles, name: str, colour: str) -> None:
    off = np.hypot(*np.moveaxis((bundles.made[name] - bundles.measured)[..., :2], -1, 0))
    low, middle, high = np.nanquantile(off, QUANTILES, axis=0)
    axis.fill_between(bundles.time, low, high, color=colour, alpha=0.2, lw=0)
    axis.plot(bundles.time, middle, color=colour, lw=1.8)
    axis.set_ylim(bottom=0)
    tidy(axis)
