"""Histograms of the recorded velocities and commands."""

from collections.abc import Mapping

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from tensordict import TensorDictBase

from buggy_rl.recordings.windows import model_inputs
from buggy_rl.viz.style import COLOURS, INPUT_LABELS

BINS = 60  # of each histogram; at 7 m/s a bin is 0.1 m/s


def histogram_figure(parts: Mapping[str, TensorDictBase]) -> Figure:
    """Histograms of `velocity` and `action` [*] of each part, the first one filled."""
    figure, axes = plt.subplots(1, 5, figsize=(15, 3), constrained_layout=True)
    filled = {"histtype": "stepfilled", "alpha": 0.35, "color": COLOURS[1]}
    for index, (name, data) in enumerate(parts.items()):
        style = {"histtype": "step", "color": COLOURS[0]} if index else filled
        rows = model_inputs(data).flatten(0, -2)
        for axis, label, values in zip(axes, INPUT_LABELS, rows.unbind(-1), strict=True):
            axis.hist(values.numpy(), BINS, density=True, label=name, **style)
            axis.set_xlabel(label)
            axis.set_yticks([])
            axis.spines[["top", "right", "left"]].set_visible(False)
    axes[0].set_ylabel("share of the rows")
    axes[0].legend(frameon=False, fontsize=8)
    return figure
