"""Trajectories of policies on their paths, coloured by speed."""

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D

from buggy_rl.policies.drives import Panel, Track
from buggy_rl.viz.style import FAINT, MEASURED, tidy

SPEEDS = "viridis"
FASTEST = 0.995  # quantile of the speeds at the end of the colour scale; excludes outliers
MARGIN = 0.25  # [m] around the trajectories
PANEL = 3.2  # [inch] width of a panel


def policies_figure(panels: Sequence[Panel]) -> Figure:
    """A row for each path, a column for each policy and simulator; pure pursuit thin and grey."""
    columns = list(dict.fromkeys((panel.policy, panel.place) for panel in panels))
    limits = _limits(panels)
    rows = list(limits)
    figure, axes = _grid(list(limits.values()), len(columns))
    speeds = np.concatenate([panel.track.velocity[:, 0].numpy() for panel in panels])
    colours = Normalize(0.0, max(float(np.quantile(speeds, FASTEST)), 0.1))
    for panel in panels:
        row, column = rows.index(panel.course), columns.index((panel.policy, panel.place))
        low, high = limits[panel.course]
        _draw(axes[row, column], panel, colours)
        axes[row, column].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    above: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points"}
    for axis, (policy, place) in zip(axes[0], columns, strict=True):
        text = axis.annotate(f"{policy}, {place}", (0.5, 1.0), (0, 26), ha="center", **above)
        text.set(fontsize=11, weight="bold")
    for axis in axes[-1]:
        axis.set_xlabel("x [m]")
    for axis in axes[:, 0]:
        axis.set_ylabel("y [m]")
    scale = ScalarMappable(colours, SPEEDS)
    figure.colorbar(scale, ax=axes, label="speed vx [m/s]", shrink=0.7, aspect=30, pad=0.01)
    across = 4 if len(columns) > 1 else 2  # entries that fit below
    figure.legend(handles=_legend(), loc="outside lower center", ncols=across, frameon=False)
    return figure


def _grid(limits: Sequence[tuple[np.ndarray, np.ndarray]], columns: int) -> tuple[Figure, Any]:
    """Axes [rows, columns] of one scale."""
    sizes = np.stack([high - low for low, high in limits])
    height = 0.94 * PANEL * sizes[:, 1].sum() / sizes[0, 0] + 0.45 * len(limits) + 1.0
    return plt.subplots(
        len(limits),
        columns,
        figsize=(PANEL * columns + 1.2, height),
        height_ratios=sizes[:, 1].tolist(),
        layout=ConstrainedLayoutEngine(h_pad=0.08, w_pad=0.06),
        squeeze=False,
    )


def _limits(panels: Sequence[Panel]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Lower and upper corner [2] of the axes of each path, equally wide for all paths."""
    limits = {}
    for panel in panels:
        drawn = (panel.waypoints, panel.track.pose[:, :2], panel.compared.pose[:, :2])
        points = np.concatenate([part.numpy() for part in drawn])
        low, high = limits.get(panel.course, (points[0], points[0]))
        limits[panel.course] = np.minimum(low, points.min(0)), np.maximum(high, points.max(0))
    widest = max(high[0] - low[0] for low, high in limits.values())
    for course, (low, high) in limits.items():
        margin = np.array([MARGIN + (widest - high[0] + low[0]) / 2, MARGIN])
        limits[course] = low - margin, high + margin
    return limits


def _draw(axis: Axes, panel: Panel, colours: Normalize) -> None:
    axis.plot(*panel.waypoints.T, ".", color=MEASURED, ms=3.5, zorder=2)
    axis.plot(*panel.compared.pose[:, :2].T, color=FAINT, lw=0.9, zorder=3)
    axis.add_collection(_line(panel.track, colours))
    axis.plot(*panel.track.pose[0, :2], "o", color=MEASURED, ms=6, mfc="white", zorder=5)
    axis.plot(*panel.track.pose[-1, :2], "s", color=MEASURED, ms=5, zorder=5)
    axis.set_title(
        f"{panel.course}: {panel.track.waypoints:.0f} waypoints, "
        f"{100 * panel.track.lateral_mean:.1f} cm off",
        fontsize=9,
    )
    axis.set_aspect("equal")
    tidy(axis)


def _line(track: Track, colours: Normalize) -> LineCollection:
    points = track.pose[:, :2].numpy()
    line = LineCollection(
        list(np.stack([points[:-1], points[1:]], 1)),
        cmap=SPEEDS,
        norm=colours,
        lw=2.2,
        capstyle="round",
        zorder=4,
    )
    line.set_array(track.velocity[1:, 0].numpy())
    return line


def _legend() -> list[Line2D]:
    shape: dict[str, Any] = {"color": MEASURED, "ls": ""}
    return [
        Line2D([], [], marker=".", label="waypoints", **shape),
        Line2D([], [], marker="o", mfc="white", label="start", **shape),
        Line2D([], [], marker="s", ms=5, label="end", **shape),
        Line2D([], [], color=FAINT, lw=0.9, label="pure pursuit"),
    ]
