"""What was driven in raw recordings: maps, coverage and delays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from buggy_rl.figures.style import COLOURS, FAINT, tidy

MOST_MAPS = 8  # drives that are drawn
POINTS = 1500  # of each drive
BINS = 50
EMPTY = "none found"


@dataclass(frozen=True)
class Panels:
    """What is drawn of a folder of drives."""

    maps: Sequence[tuple[str, NDArray[Any], NDArray[Any]]]
    """Name, x and y [N, 2] m, speed [N] m/s of each drive; NaN where there is no pose."""
    speed: NDArray[Any]
    """[N] of all drives [m/s]."""
    steering: NDArray[Any]
    """[N] in the file's unit, positive to the left; NaN without a column."""
    throttle: NDArray[Any]
    """[N] in the file's unit."""
    delays: Mapping[str, Sequence[tuple[NDArray[Any], NDArray[Any]]]]
    """Command -> lags [L] s and correlations [L] of each drive."""


def inspection_figure(panels: Panels) -> Figure:
    """Draws maps, coverage and delays on one sheet."""
    figure = Figure(figsize=(13, 10), layout="constrained")
    parts: Any = figure.subfigures(3, 1, height_ratios=[1.6, 1, 1])
    maps, coverage, delays = parts
    _draw_maps(maps, panels)
    _draw_coverage(coverage, panels)
    _draw_delays(delays, panels)
    return figure


def map_figure(panels: Panels) -> Figure:
    """Each drive on its floor, by speed."""
    figure = Figure(figsize=(10, 5), layout="constrained")
    _draw_maps(figure, panels)
    return figure


def coverage_figure(panels: Panels) -> Figure:
    """Histograms of speed and throttle, and steering over speed."""
    figure = Figure(figsize=(10, 2.8), layout="constrained")
    _draw_coverage(figure, panels)
    return figure


def lag_figure(panels: Panels) -> Figure:
    """Correlation over lag, a line each drive."""
    figure = Figure(figsize=(10, 2.8), layout="constrained")
    _draw_delays(figure, panels)
    return figure


def _draw_maps(figure, panels: Panels) -> None:
    shown = panels.maps[:MOST_MAPS]
    columns = min(4, max(len(shown), 1))
    axes = figure.subplots(-(-max(len(shown), 1) // columns), columns, squeeze=False)
    fastest = _beyond(np.abs(panels.speed))
    points = None
    for axis in axes.flat:
        axis.set_visible(False)
    for axis, (name, xy, speed) in zip(axes.flat, shown, strict=False):
        axis.set_visible(True)
        step = max(1, len(xy) // POINTS)
        style = {"c": speed[::step], "s": 2, "cmap": "viridis", "vmin": 0, "vmax": fastest}
        points = axis.scatter(*xy[::step].T, rasterized=True, **style)
        axis.set_title(name if len(name) < 30 else f"…{name[-28:]}", fontsize=8)
        axis.set_aspect("equal", adjustable="datalim")
        tidy(axis)
    if points is not None:
        figure.colorbar(points, ax=list(axes.flat), label="speed [m/s]", shrink=0.8)
    figure.supxlabel("x [m]", fontsize=9)
    figure.supylabel("y [m]", fontsize=9)


def _draw_coverage(figure, panels: Panels) -> None:
    axes = figure.subplots(1, 3)
    _histogram(axes[0], panels.speed, "speed [m/s]")
    _histogram(axes[1], panels.throttle, "throttle, as in the file")
    good, fastest = np.isfinite(panels.steering), _beyond(np.abs(panels.speed))
    if good.any():
        axes[2].hist2d(
            panels.steering[good],
            panels.speed[good].clip(-fastest, fastest),
            BINS,
            cmin=1,
            cmap="viridis",
            rasterized=True,
        )
    else:
        axes[2].text(0.5, 0.5, EMPTY, ha="center", transform=axes[2].transAxes)
    axes[2].set(xlabel="steering from its centre, as in the file, + left", ylabel="speed [m/s]")
    tidy(axes[2])


def _beyond(values: NDArray[Any]) -> float:
    """Value that only outliers exceed."""
    return float(np.quantile(values, 0.995)) if len(values) else 1.0


def _histogram(axis: Axes, values: NDArray[Any], label: str) -> None:
    good = values[np.isfinite(values)]
    if len(good):
        low, high = np.quantile(good, [0.001, 0.999])
        axis.hist(good.clip(low, high), BINS, density=True, color=COLOURS[1], alpha=0.8)
    else:
        axis.text(0.5, 0.5, EMPTY, ha="center", transform=axis.transAxes)
    axis.set(xlabel=label, yticks=[])
    tidy(axis)


def _draw_delays(figure, panels: Panels) -> None:
    axes = figure.subplots(1, max(len(panels.delays), 1), squeeze=False)[0]
    for axis, (command, lines) in zip(axes, panels.delays.items(), strict=False):
        for lags, found in lines:
            axis.plot(1000 * lags, found, color=FAINT, lw=0.8)
        if lines:
            mean = np.nanmean([found for _, found in lines], axis=0)
            axis.plot(1000 * lines[0][0], mean, color=COLOURS[0], lw=2)
            best = int(np.nanargmax(np.abs(mean)))
            axis.axvline(1000 * lines[0][0][best], color=COLOURS[0], lw=0.8, ls=":")
            axis.set_title(f"{command}: strongest at {1000 * lines[0][0][best]:.0f} ms", fontsize=9)
        axis.set(xlabel="later by [ms]", ylabel="correlation")
        tidy(axis)
