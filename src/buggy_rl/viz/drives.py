"""What was driven: distributions of speeds and commands."""

from collections.abc import Mapping

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from tensordict import TensorDictBase

from buggy_rl.recordings.windows import model_inputs
from buggy_rl.viz.style import COLOURS, INPUT_LABELS


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
