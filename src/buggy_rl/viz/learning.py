"""Learning curves of policies."""

from collections.abc import Sequence

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from buggy_rl.policies.learning_curves import SHOWN, Curve
from buggy_rl.viz.style import COLOURS, tidy

MILLION = 1e6
SPARSE = 30  # points of a curve below which they get markers; chosen


def learning_figure(curves: Sequence[Curve]) -> Figure:
    """Waypoints closed over training steps: mean of all seeds, and band from worst to best.

    A colour for each name, a panel for each metric.
    """
    figure, axes = plt.subplots(1, len(SHOWN), figsize=(10, 4), layout="constrained", sharey=True)
    names = list(dict.fromkeys(curve.name for curve in curves))
    for axis, (metric, paths) in zip(axes, SHOWN.items(), strict=True):
        for curve in (c for c in curves if c.metric == metric):
            _draw(axis, curve, COLOURS[names.index(curve.name) % len(COLOURS)])
        axis.set_title(f"{paths} paths" + (", while exploring" if paths == "training" else ""))
        axis.set_xlabel("steps [million]")
        axis.set_xlim(left=0)
        tidy(axis)
    axes[0].set_ylim(bottom=0)
    axes[0].set_ylabel("waypoints closed in an episode")
    axes[-1].legend(frameon=False, fontsize=9, loc="lower right")
    return figure


def _draw(axis, curve: Curve, colour: str) -> None:
    steps, band = curve.band.index / MILLION, curve.band
    label = f"{curve.name}, {curve.runs} seeds" if curve.runs > 1 else curve.name
    marker = "o" if len(band) < SPARSE else None
    axis.fill_between(steps, band["low"], band["high"], color=colour, alpha=0.2, lw=0)
    axis.plot(steps, band["mean"], color=colour, lw=1.8, marker=marker, ms=4, label=label)
    if curve.score is not None:
        label = f"{curve.name}, pure pursuit"
        axis.axhline(curve.score, color=colour, ls="--", lw=1.2, label=label)
