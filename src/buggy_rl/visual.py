"""Pictures: what was driven, and what simulators make of it."""

from collections.abc import Mapping, Sequence

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import torch
from matplotlib.figure import Figure
from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.dataset import model_inputs, relative_pose
from buggy_rl.paths import PathSet

MEASURED = "#222222"
COLOURS = ("#d1495b", "#00798c", "#edae49", "#66a182", "#8d6a9f", "#2e4057")
INPUT_LABELS = ("vx [m/s]", "vy [m/s]", "yaw rate [rad/s]", "throttle [-]", "steering [-]")


def rollout_figure(
    measured: TensorDictBase, made: Mapping[str, TensorDictBase], columns: int = 4
) -> Figure:
    """Paths and channels of rollouts beside what was measured.

    Args:
        measured: [N, H + 1] with `pose` and `velocity`.
        made: The same rows as each simulator made them, by its name.
        columns: Windows shown, from the calmest to the liveliest.
    """
    # Windows of different liveliness: quantiles of the distance driven, at rest left out.
    distance = measured[keys.VELOCITY][..., 0].abs().mean(1)
    order = distance.argsort()
    places = torch.linspace(0.45, 0.98, columns) * (len(order) - 1)
    chosen = order[places.round().long()].tolist()
    figure, axes = plt.subplots(
        4, columns, figsize=(3.4 * columns, 10.5), constrained_layout=True, squeeze=False
    )
    time = torch.arange(measured.batch_size[1]) * 0.01
    for column, index in enumerate(chosen):
        for place, (name, rows) in enumerate([("measured", measured), *made.items()]):
            colour = MEASURED if place == 0 else COLOURS[(place - 1) % len(COLOURS)]
            style = {"color": colour, "lw": 2.6 if place == 0 else 1.5, "label": name}
            path = relative_pose(rows[keys.POSE][index])
            axes[0, column].plot(path[:, 0], path[:, 1], **style)
            axes[0, column].plot(path[-1, 0], path[-1, 1], "o", color=colour, ms=4)
            for line, channel in enumerate(rows[keys.VELOCITY][index].unbind(-1), 1):
                axes[line, column].plot(time, channel, **style)
        axes[0, column].set_aspect("equal", adjustable="datalim")
        axes[0, column].set_xlabel("x [m]")
        axes[3, column].set_xlabel("time [s]")
    for line, label in enumerate(("y [m]", *INPUT_LABELS[:3])):
        axes[line, 0].set_ylabel(label)
    for axis in axes.flat:
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


def histogram_figure(parts: Mapping[str, TensorDictBase]) -> Figure:
    """Distributions of what was driven, such as before and after mirroring.

    Args:
        parts: Rows [*] with `velocity` and `action`, by what they are called.
    """
    figure, axes = plt.subplots(1, 5, figsize=(15, 3), constrained_layout=True)
    for place, (name, data) in enumerate(parts.items()):
        rows = model_inputs(data).flatten(0, -2)
        for axis, label, values in zip(axes, INPUT_LABELS, rows.unbind(-1), strict=True):
            axis.hist(
                values.numpy(),
                60,
                density=True,
                histtype="stepfilled" if place == 0 else "step",
                alpha=0.35 if place == 0 else 1.0,
                color=COLOURS[1] if place == 0 else COLOURS[0],
                label=name,
            )
            axis.set_xlabel(label)
            axis.set_yticks([])
            axis.spines[["top", "right", "left"]].set_visible(False)
    axes[0].legend(frameon=False, fontsize=8)
    return figure


def table_figure(rows: Sequence[Mapping[str, float | str]]) -> Figure:
    """1 s position error of every simulator with its interval, best first; logarithmic."""
    ordered = sorted(rows, key=lambda row: row["position_mse_1s"], reverse=True)
    figure, axis = plt.subplots(figsize=(8, 0.34 * len(ordered) + 1.2), constrained_layout=True)
    for place, row in enumerate(ordered):
        value, low, high = (float(row[k]) for k in ("position_mse_1s", "low", "high"))
        axis.plot([max(low, 1e-6), high], [place, place], color=COLOURS[1], lw=3, alpha=0.45)
        axis.plot(value, place, "o", color=COLOURS[1])
    axis.set_yticks(range(len(ordered)), [str(row["simulator"]) for row in ordered])
    axis.set_ylim(-0.7, len(ordered) - 0.3)
    axis.set_xscale("log")
    axis.set_xlabel("1 s open-loop position MSE on held-out drives [m²]")
    axis.grid(alpha=0.25, axis="x", which="both")
    axis.spines[["top", "right"]].set_visible(False)
    return figure


def paths_figure(
    sets: Mapping[str, PathSet], shown: int = 5, waypoints: int = 100, columns: int = 3
) -> Figure:
    """Sets of paths side by side, each with its tightest turn.

    Args:
        sets: By what they are called.
        shown: Paths of a set in colour, with their waypoints; the others are drawn faintly.
        waypoints: Of each open path that are drawn.
        columns: Sets in a row.
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
            colour = COLOURS[index % len(COLOURS)] if index < shown else MEASURED
            axis.plot(*line.T, color=colour, lw=0.8, alpha=1.0 if index < shown else 0.08)
            if index < shown:
                axis.plot(*line.T, ".", color=colour, ms=2.5)
        axis.plot(*paths.start[:shown, :2].T, "o", color=MEASURED, ms=4)
        radius = 1 / float(paths.largest_curvature.max())
        number = f"{len(paths)} paths, " if len(paths) > 1 else ""
        axis.set_title(f"{name}: {number}tightest turn {radius:.2g} m", fontsize=9)
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("x [m]")
        axis.grid(alpha=0.25)
        axis.spines[["top", "right"]].set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel("y [m]")
    return figure
