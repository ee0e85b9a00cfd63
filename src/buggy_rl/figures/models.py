"""Models and simulators: errors, rollouts, training losses, tables and runs compared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import torch
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from tensordict import TensorDictBase

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.figures.style import COLOURS, INPUT_LABELS, MEASURED_COLOUR, tidy
from buggy_rl.policies.evaluation.comparison import Comparison
from buggy_rl.recordings.windows import relative_pose

SIZE = 4.6, 3.9  # [inch]
CELLS = 9, 8  # of steering and of speed
FEW = 3  # instants below which a cell is left out
BRIGHTEST = 0.97  # quantile of the errors at the end of the colour scale; excludes spins
ERROR_COLOURS = LinearSegmentedColormap.from_list(
    "error", ["#f3ede6", "#edae49", "#d1495b", "#5c1a33"]
)
RAMP = [to_hex(ERROR_COLOURS(share)) for share in np.linspace(0.3, 1.0, 8)]
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
        cmap=ERROR_COLOURS,
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
        steering, speed, mean.T, cmap=ERROR_COLOURS, norm=scale, edgecolors="white", lw=0.6
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
    """Scale of colours from 0 to the brightest quantile; noise alone is 1."""
    most = float(np.quantile(size, BRIGHTEST)) if len(size) else 0.0
    return Normalize(0.0, max(most, 2.0))


def comparison_figure(comparison: Comparison) -> Figure:
    """A panel for each metric, a colour for each group: mean over its runs and their range."""
    groups = list(dict.fromkeys(group for group, _ in comparison.bands))
    metrics = list(dict.fromkeys(metric for _, metric in comparison.bands))
    size = (5 * len(metrics), 4)
    figure, axes = plt.subplots(1, len(metrics), figsize=size, layout="constrained", squeeze=False)
    for (group, metric), band in comparison.bands.items():
        axis, colour = axes[0, metrics.index(metric)], COLOURS[groups.index(group) % len(COLOURS)]
        axis.fill_between(band.index, band["low"], band["high"], color=colour, alpha=0.2, lw=0)
        axis.plot(band.index, band["mean"], color=colour, lw=1.8, label=group)
    for axis, metric in zip(axes[0], metrics, strict=True):
        axis.set_title(metric)
        axis.set_xlabel("environment steps")
        tidy(axis)
    axes[0, -1].legend(frameon=False, fontsize=9)
    return figure


CLOSE = 100.0  # [-] end over beginning of an axis, up to which 2 and 5 have labels too


def table_figure(rows: Sequence[Mapping[str, float | str]]) -> Figure:
    """1 s position MSE of each simulator with its interval, smallest first, logarithmic."""
    ordered = sorted(rows, key=lambda row: row["position_mse_1s"], reverse=True)
    figure, axis = plt.subplots(figsize=(8, 0.34 * len(ordered) + 1.2), constrained_layout=True)
    for line, row in enumerate(ordered):
        value, low, high = (float(row[k]) for k in ("position_mse_1s", "low", "high"))
        axis.plot([max(low, 1e-6), high], [line, line], color=COLOURS[1], lw=3, alpha=0.45)
        axis.plot(value, line, "o", color=COLOURS[1])
    axis.set_yticks(range(len(ordered)), [str(row["simulator"]) for row in ordered])
    axis.set_ylim(-0.7, len(ordered) - 0.3)
    axis.set_xscale("log")
    low, high = axis.get_xlim()
    plain = StrMethodFormatter("{x:g}")
    axis.xaxis.set_major_formatter(plain)
    axis.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    axis.xaxis.set_minor_formatter(plain if high < CLOSE * low else NullFormatter())
    axis.set_xlabel("1 s open-loop position MSE on held-out recordings [m²]")
    axis.grid(alpha=0.25, axis="x", which="both")
    axis.spines[["top", "right"]].set_visible(False)
    return figure


SHOWN = (0.45, 0.98)  # quantiles of the distance driven between which segments are shown; chosen


def rollout_figure(
    measured: TensorDictBase, made: Mapping[str, TensorDictBase], columns: int = 4
) -> Figure:
    """Paths and velocities of rollouts beside the recording, over rollout segments.

    Args:
        measured: [N, H + 1] with `pose` and `velocity`.
        made: Simulator -> its rollouts [N, H + 1] of the same segments.
        columns: Segments shown, from slow to fast.
    """
    distance = measured[keys.VELOCITY][..., 0].abs().mean(1)
    order = distance.argsort()
    quantiles = torch.linspace(*SHOWN, columns) * (len(order) - 1)
    chosen = order[quantiles.round().long()].tolist()
    figure, axes = plt.subplots(
        4, columns, figsize=(3.4 * columns, 10.5), constrained_layout=True, squeeze=False
    )
    time = torch.arange(measured.batch_size[1]) * CONTROL_PERIOD
    for column, segment in enumerate(chosen):
        for index, (name, rows) in enumerate([("measured", measured), *made.items()]):
            colour = COLOURS[(index - 1) % len(COLOURS)] if index else MEASURED_COLOUR
            style = {"color": colour, "lw": 1.5 if index else 2.6, "label": name}
            path = relative_pose(rows[keys.POSE][segment])
            axes[0, column].plot(path[:, 0], path[:, 1], **style)
            axes[0, column].plot(path[-1, 0], path[-1, 1], "o", color=colour, ms=4)
            for line, channel in enumerate(rows[keys.VELOCITY][segment].unbind(-1), 1):
                axes[line, column].plot(time, channel, **style)
        axes[0, column].set_aspect("equal", adjustable="datalim")
        axes[0, column].set_xlabel("x [m]")
        axes[3, column].set_xlabel("time [s]")
    for line, label in enumerate(("y [m]", *INPUT_LABELS[:3])):
        axes[line, 0].set_ylabel(label)
    for axis in axes.flat:
        tidy(axis)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


COLUMNS = 3


def training_figure(logs: Mapping[str, Mapping[str, pd.DataFrame]]) -> Figure:
    """A panel for each model, a colour for each preparation; dashed is the training loss.

    Args:
        logs: Model -> preparation -> `training_loss`, `validation_loss` by epoch.
    """
    columns = min(COLUMNS, len(logs))
    rows = -(-len(logs) // columns)
    figure = Figure(figsize=(3.6 * columns, 2.9 * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for axis in axes.flat[len(logs) :]:
        axis.set_axis_off()
    for axis, (model, preparations) in zip(axes.flat, logs.items(), strict=False):
        for colour, (name, log) in zip(COLOURS, preparations.items(), strict=False):
            axis.plot(log.index, log["training_loss"], color=colour, ls="--", lw=1.0)
            axis.plot(log.index, log["validation_loss"], color=colour, lw=1.8, label=name)
        axis.set_yscale("log")
        low, high = axis.get_ylim()
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter("{x:g}" if high < 3 * low else NullFormatter())
        axis.set_title(model, fontsize=10)
        axis.set_xlabel("epoch")
        axis.legend(frameon=False, fontsize=8)
        tidy(axis)
    for axis in axes[:, 0]:
        axis.set_ylabel("loss, standardised [-]\n(dashed: training)")
    return figure
