"""Rollouts of simulators beside the recording."""

from collections.abc import Mapping

import matplotlib.pyplot as plt
import torch
from matplotlib.figure import Figure
from tensordict import TensorDictBase

from buggy_rl import keys
from buggy_rl.recordings.windows import relative_pose
from buggy_rl.vehicle import CONTROL_PERIOD
from buggy_rl.viz.style import COLOURS, INPUT_LABELS, MEASURED, tidy

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
            colour = COLOURS[(index - 1) % len(COLOURS)] if index else MEASURED
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
