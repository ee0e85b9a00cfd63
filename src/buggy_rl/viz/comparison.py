"""Curves of compared runs."""

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from buggy_rl.policies.comparison import Comparison
from buggy_rl.viz.style import COLOURS, tidy


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
