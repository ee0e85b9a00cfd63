"""Losses of learned models over the epochs of their training."""

from collections.abc import Mapping

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from buggy_rl.viz.style import COLOURS, tidy

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
