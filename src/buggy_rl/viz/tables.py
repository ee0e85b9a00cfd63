"""Figure of the simulators' open-loop errors."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from buggy_rl.viz.style import COLOURS

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
