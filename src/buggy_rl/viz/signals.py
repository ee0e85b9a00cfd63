"""Raw and filtered velocities, and the labels that models learn from them."""

from dataclasses import dataclass
from typing import Any

from matplotlib.figure import Figure
from numpy.typing import NDArray

from buggy_rl.viz.style import COLOURS, FAINT, INPUT_LABELS, tidy

RATES = ("d vx / dt [m/s²]", "d vy / dt [m/s²]", "d yaw rate / dt [rad/s²]")


@dataclass(frozen=True)
class Signals:
    """Rows of a recording, K instants."""

    time: NDArray[Any]
    """[K] s"""
    raw: NDArray[Any]
    """[K, 3] vx, vy [m/s], yaw_rate [rad/s] as recorded."""
    filtered: NDArray[Any]
    """[K, 3] by a causal mean."""
    dt: float
    """Control period [s]."""
    width: int
    """Rows of that mean."""


def signals_figure(signals: Signals) -> Figure:
    """Velocities on the left, their differences from row to row on the right."""
    figure = Figure(figsize=(10, 6), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True)
    lines = {
        "as recorded": (signals.raw, {"color": FAINT, "lw": 1.0}),
        f"mean of the last {signals.width} rows": (
            signals.filtered,
            {"color": COLOURS[1], "lw": 1.6},
        ),
    }
    for row in range(3):
        for name, (values, style) in lines.items():
            rate = (values[1:, row] - values[:-1, row]) / signals.dt
            axes[row, 0].plot(signals.time, values[:, row], label=name, **style)
            axes[row, 1].plot(signals.time[1:], rate, **style)
        axes[row, 0].set_ylabel(INPUT_LABELS[row])
        axes[row, 1].set_ylabel(RATES[row])
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    for axis in axes.flat:
        tidy(axis)
    figure.align_ylabels(axes)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return figure
