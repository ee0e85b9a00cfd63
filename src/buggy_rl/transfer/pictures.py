"""One picture for all cars: what a policy closes in simulation and on the car."""

from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from buggy_rl.viz.style import COLOURS, MEASURED, tidy

SPREAD = 0.7  # of the room between two cars that their arms take up
BESIDE = 0.06  # [cars] how far the seeds stand beside their mean


def transfer_figure(drives: pd.DataFrame) -> Figure:
    """A place for each car, in it a line for each arm from its simulator (open) to the car (dot).

    Small dots are the seeds on the car. The drives are those of `score.pairs`.
    """
    arms, cars = list(drives.arm.unique()), list(drives.car.unique())
    figure, axis = plt.subplots(
        figsize=(max(1.3 * len(cars) + 1.5, 9.0), 4.2), layout="constrained"
    )
    for number, arm in enumerate(arms):
        for place, car in enumerate(cars):
            here = drives[(drives.car == car) & (drives.arm == arm)]
            own, there, colour = here.own.mean(), here.there.mean(), COLOURS[number]
            seeds = here.groupby("seed", sort=False).there.mean()
            x = place + SPREAD * ((number + 0.5) / len(arms) - 0.5)
            axis.plot([x, x], [own, there], color=colour, lw=2.5, alpha=0.35)
            axis.plot(x, own, "o", color=colour, mfc="white", ms=6)
            axis.plot(x, there, "o", color=colour, ms=6)
            axis.plot([x + BESIDE] * len(seeds), seeds, ".", color=colour, ms=3)
    axis.set_xticks(range(len(cars)), [car.replace("_", "\n") for car in cars])
    axis.set_ylabel("waypoints closed a minute")
    axis.set_ylim(bottom=0.0)
    tidy(axis)
    shape: dict[str, Any] = {"color": MEASURED, "marker": "o", "ls": ""}
    handles = [Line2D([], [], color=COLOURS[n], lw=4, label=arm) for n, arm in enumerate(arms)]
    handles += [Line2D([], [], mfc="white", label="in its simulator", **shape)]
    handles += [Line2D([], [], label="on the car", **shape)]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
    return figure
