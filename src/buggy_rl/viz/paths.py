"""Reference paths."""

from collections.abc import Mapping

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from buggy_rl.task.paths.path_set import PathSet
from buggy_rl.viz.style import COLOURS, MEASURED, tidy


def paths_figure(
    sets: Mapping[str, PathSet], shown: int = 5, waypoints: int = 100, columns: int = 3
) -> Figure:
    """Sets of paths side by side, each with its smallest turning radius.

    Args:
        sets: Name -> paths.
        shown: Paths of a set in colour with their waypoints; the others are faint.
        waypoints: Number drawn of each open path.
        columns: Sets in a row of the figure.
    """
    rows = -(-len(sets) // columns)
    figure, axes = plt.subplots(
        rows, columns, figsize=(4.2 * columns, 4.2 * rows), constrained_layout=True, squeeze=False
    )
    for axis in axes.flat[len(sets) :]:
        axis.set_axis_off()
    for axis, (name, paths) in zip(axes.flat, sets.items(), strict=False):
        points = paths.extended(1)
        for index in reversed(range(len(paths))):
            closed, count = bool(paths.closed[index]), int(paths.count[index])
            last = count + 1 if closed else min(count, waypoints)
            line = points[index, :last]
            colour = COLOURS[index % len(COLOURS)] if index < shown else MEASURED
            faint = {"alpha": 0.08, "rasterized": True}  # a thousand vector paths are megabytes
            axis.plot(*line.T, color=colour, lw=0.8, **({} if index < shown else faint))
            if index < shown:
                axis.plot(*line.T, ".", color=colour, ms=2.5)
        axis.plot(*paths.start[:shown, :2].T, "o", color=MEASURED, ms=4)
        radius = 1 / float(paths.largest_curvature.max())
        number = f"{len(paths)} paths, " if len(paths) > 1 else ""
        axis.set_title(f"{name}: {number}tightest turn {radius:.2g} m", fontsize=9)
        axis.set_aspect("equal", adjustable="datalim")
        axis.set_xlabel("x [m]")
        tidy(axis)
    for axis in axes[:, 0]:
        axis.set_ylabel("y [m]")
    return figure
