"""Rollouts of simulators beside what was measured."""

from collections.abc import Mapping

import matplotlib.pyplot as plt
import torch
from matplotlib.figure import Figure
from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.recordings.windows import relative_pose
from buggy_rl.viz.style import COLOURS, INPUT_LABELS, MEASURED, tidy


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
        tidy(axis)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    return figure
