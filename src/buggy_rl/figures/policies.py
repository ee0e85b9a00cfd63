"""Policies: trajectories by speed, learning curves, sweeps, reference paths."""

from collections.abc import Mapping, Sequence
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

from buggy_rl.figures.style import COLOURS, FAINT, MEASURED_COLOUR, tidy
from buggy_rl.policies.evaluation.drives import DrivenTrack, Panel
from buggy_rl.policies.evaluation.tables import Result
from buggy_rl.policies.training.seeds import SHOWN, Curve
from buggy_rl.policies.training.sweep import Ended
from buggy_rl.task.paths.path_set import PathSet

SPEEDS = "viridis"
FASTEST = 0.995  # quantile of the speeds at the end of the colour scale; excludes outliers
HEADROOM = 1.08  # [-] axis over its largest number
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
    axis.plot(*panel.waypoints.T, ".", color=MEASURED_COLOUR, ms=3.5, zorder=2)
    axis.plot(*panel.compared.pose[:, :2].T, color=FAINT, lw=0.9, zorder=3)
    axis.add_collection(_line(panel.track, colours))
    axis.plot(*panel.track.pose[0, :2], "o", color=MEASURED_COLOUR, ms=6, mfc="white", zorder=5)
    axis.plot(*panel.track.pose[-1, :2], "s", color=MEASURED_COLOUR, ms=5, zorder=5)
    axis.set_title(
        f"{panel.course}: {panel.track.waypoints:.0f} waypoints, "
        f"{100 * panel.track.lateral_mean:.1f} cm off",
        fontsize=9,
    )
    axis.set_aspect("equal")
    tidy(axis)


def _line(track: DrivenTrack, colours: Normalize) -> LineCollection:
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
    shape: dict[str, Any] = {"color": MEASURED_COLOUR, "ls": ""}
    return [
        Line2D([], [], marker=".", label="waypoints", **shape),
        Line2D([], [], marker="o", mfc="white", label="start", **shape),
        Line2D([], [], marker="s", ms=5, label="end", **shape),
        Line2D([], [], color=FAINT, lw=0.9, label="pure pursuit"),
    ]


def seeds_figure(found: Sequence[Result], car: str) -> Figure:
    """Waypoints of each seed on each path: in its own simulator, and on the car.

    Hollow where its policy spun or left its path.
    """
    courses = list(dict.fromkeys(r.course for r in found if r.place == "car"))
    kinds = list(dict.fromkeys(r.policy for r in found))
    figure, axes = plt.subplots(
        1, len(courses), figsize=(PANEL * len(courses), 3.4), layout="constrained", squeeze=False
    )
    for axis, course in zip(axes[0], courses, strict=True):
        places = [(kind, place) for kind in kinds for place in (kind, "car")]
        for at, (kind, place) in enumerate(places):
            own = [r for r in found if (r.policy, r.place, r.course) == (kind, place, course)]
            for result in own:
                _draw_seeds(axis, at, result, COLOURS[kinds.index(kind) % len(COLOURS)])
        labels = [f"{kind},\n{car if place == 'car' else 'own'}" for kind, place in places]
        axis.set_xticks(range(len(places)), labels, fontsize=8)
        axis.set_title(course)
        axis.set_ylim(0, HEADROOM * axis.dataLim.y1)
        axis.set_xlim(-0.5, len(places) - 0.5)
        tidy(axis)
    axes[0, 0].set_ylabel("waypoints closed")
    hollow = Line2D([], [], marker="o", ms=5, ls="", color=MEASURED_COLOUR, mfc="white")
    full = Line2D([], [], marker="o", ms=5, ls="", color=MEASURED_COLOUR)
    labels = ["a seed's policy", "one that spun or left its path"]
    figure.legend([full, hollow], labels, loc="outside lower center", ncols=2, frameon=False)
    return figure


def _draw_seeds(axis: Axes, at: int, result: Result, colour: str) -> None:
    count = len(result.seeds)
    beside = at + (np.arange(count) - (count - 1) / 2) * min(0.05, 0.6 / count)
    for x, waypoints, failed in zip(beside, result.seeds, result.failed, strict=True):
        axis.plot(x, waypoints, "o", ms=5, color=colour, mfc="white" if failed else colour)


MILLION = 1e6
SPARSE = 30  # points of a curve below which they get markers; chosen


def learning_figure(curves: Sequence[Curve]) -> Figure:
    """Waypoints closed over training steps: mean of all seeds, and band from worst to best.

    A colour for each name, a panel for each metric.
    """
    figure, axes = plt.subplots(1, len(SHOWN), figsize=(10, 4), layout="constrained", sharey=True)
    names = list(dict.fromkeys(curve.name for curve in curves))
    for axis, (metric, paths) in zip(axes, SHOWN.items(), strict=True):
        for curve in (c for c in curves if c.metric == metric):
            _draw_curve(axis, curve, COLOURS[names.index(curve.name) % len(COLOURS)])
        axis.set_title(f"{paths} paths" + (", while exploring" if paths == "training" else ""))
        axis.set_xlabel("steps [million]")
        axis.set_xlim(left=0)
        tidy(axis)
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel("waypoints closed in an episode")
    axes[-1].legend(frameon=False, fontsize=9, loc="lower right")
    return figure


def _draw_curve(axis, curve: Curve, colour: str) -> None:
    steps, band = curve.band.index / MILLION, curve.band
    label = f"{curve.name}, {curve.runs} seeds" if curve.runs > 1 else curve.name
    marker = "o" if len(band) < SPARSE else None
    axis.fill_between(steps, band["low"], band["high"], color=colour, alpha=0.2, lw=0)
    axis.plot(steps, band["mean"], color=colour, lw=1.8, marker=marker, ms=4, label=label)
    if curve.score is not None:
        label = f"{curve.name}, pure pursuit"
        axis.axhline(curve.score, color=colour, ls="--", lw=1.2, label=label)


LOOKS = {"complete": ("o", COLOURS[1]), "pruned": ("x", FAINT)}


def sweep_figure(trials: Sequence[Ended], seeds: Mapping[str, Sequence[float]]) -> Figure:
    """Left: best validation of each trial. Right: each setting's seeds, mean and sd.

    Args:
        trials: With at least one validation each, or failed.
        seeds: Setting -> waypoints on the validation paths, one a seed.
    """
    picture, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
    for state, (marker, colour) in LOOKS.items():
        shown = [trial for trial in trials if trial.state == state and trial.curve]
        best = [max(trial.curve) for trial in shown]
        left.plot([t.number for t in shown], best, marker, color=colour, label=state)
    left.set(xlabel="trial", ylabel="waypoints, validation paths", title="Search, one seed")
    left.legend()
    for place, values in enumerate(seeds.values()):
        right.plot([place] * len(values), values, "o", color=FAINT, markersize=4)
        deviation = np.std(values, ddof=1) if len(values) > 1 else 0.0
        right.errorbar(
            place + 0.15, np.mean(values), deviation, fmt="o", color=COLOURS[1], capsize=4
        )
    right.set_xticks(range(len(seeds)), list(seeds), rotation=20)
    right.set(title="Further seeds, mean and sd")
    tidy(left)
    tidy(right)
    return picture


def paths_figure(
    sets: Mapping[str, PathSet], shown: int = 5, waypoints: int = 100, columns: int = 3
) -> Figure:
    """Sets of paths side by side, each with its smallest turning radius.

    Args:
        sets: Name -> paths.
        shown: Paths of a set in colour with their waypoints; the others are faint.
        waypoints: Number drawn of each open path.
        columns: Sets in a row of the figure.
    """
    rows = -(-len(sets) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4.2 * columns, 4.2 * rows), constrained_layout=True, squeeze=False
    )
    for axis in axes.flat[len(sets) :]:
        axis.set_axis_off()
    for axis, (name, paths) in zip(axes.flat, sets.items(), strict=False):
        points = paths.extended(1)
        for index in reversed(range(len(paths))):
            closed, count = bool(paths.closed[index]), int(paths.count[index])
            last = count + 1 if closed else min(count, waypoints)
            line = points[index, :last]
            colour = COLOURS[index % len(COLOURS)] if index < shown else MEASURED_COLOUR
            faint = {"alpha": 0.08, "rasterized": True}  # a thousand vector paths are megabytes
            axis.plot(*line.T, color=colour, lw=0.8, **({} if index < shown else faint))
            if index < shown:
                axis.plot(*line.T, ".", color=colour, ms=2.5)
        axis.plot(*paths.start[:shown, :2].T, "o", color=MEASURED_COLOUR, ms=4)
        radius = 1 / float(paths.largest_curvature.max())
        number = f"{len(paths)} paths, " if len(paths) > 1 else ""
        axis.set_title(f"{name}: {number}tightest turn {radius:.2g} m", fontsize=9)
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("x [m]")
        tidy(axis)
    for axis in axes[:, 0]:
        axis.set_ylabel("y [m]")
    return figure
