"""A manoeuvre to drive: its path on the floor, its commands, and what hypotheses predict of it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from buggy_rl.viz.replays import COMMANDS
from buggy_rl.viz.style import COLOURS, FAINT, MEASURED, tidy

SIZE = 8.4, 3.4  # [inch]
CHANNELS = {3: "speed vx [m/s]", 4: "lateral speed vy [m/s]", 5: "yaw rate [rad/s]"}
LEAST = 0.5  # [m] extent of the floor, at least


@dataclass(frozen=True)
class ManoeuvrePlan:
    """Commands of T rows, and the motion that each hypothesis predicts."""

    time: np.ndarray
    """[T] s"""
    action: np.ndarray
    """[T, 2] throttle and steering."""
    predicted: Mapping[str, np.ndarray]
    """Name of a hypothesis -> [T, 6] x, y [m], yaw [rad], vx, vy [m/s], yaw_rate [rad/s]."""

    @property
    def telling(self) -> int:
        """Column of the velocity in which the predictions differ most for its size."""
        motions = np.nan_to_num(np.stack(list(self.predicted.values())))[:, :, 3:]  # (H, T, 3)
        apart = np.sqrt(motions.var(0).mean(0)) / (np.abs(motions).max((0, 1)) + 0.1)
        return 3 + int(apart.argmax())


def manoeuvre_figure(plan: ManoeuvrePlan) -> Figure:
    """Path on the left; commands, and the velocity that tells hypotheses apart, on the right."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplot_mosaic([["floor", "commands"], ["floor", "telling"]])
    floor, commands, telling = axes["floor"], axes["commands"], axes["telling"]
    column = plan.telling
    for (name, motion), colour in zip(plan.predicted.items(), COLOURS, strict=False):
        floor.plot(motion[:, 0], motion[:, 1], color=colour, lw=1.8, label=f"if {name}")
        telling.plot(plan.time, motion[:, column], color=colour, lw=1.5)
    floor.plot(0, 0, "o", color=MEASURED, mfc="white", ms=7, zorder=6)
    floor.annotate("start", (0, 0), (6, 6), textcoords="offset points", color=MEASURED, fontsize=8)
    floor.set(xlabel="x, ahead [m]", ylabel="y, left [m]")
    floor.set_aspect("equal", adjustable="datalim")
    floor.axhline(0, color=FAINT, lw=0.5, zorder=1)
    for (name, colour), values in zip(COMMANDS, plan.action.T, strict=True):
        commands.plot(plan.time, values, color=colour, lw=1.6, label=name)
    commands.set(ylabel="commands [-]", ylim=(-1.08, 1.08))
    commands.tick_params(labelbottom=False)
    commands.legend(frameon=False, fontsize=8, ncols=2, loc="lower right")
    telling.set(xlabel="time [s]", ylabel=CHANNELS[column])
    telling.sharex(commands)
    for axis in (floor, commands, telling):
        tidy(axis)
    reach = np.nan_to_num(np.concatenate([m[:, :2] for m in plan.predicted.values()]))
    if float(np.ptp(reach, 0).max()) < LEAST:
        floor.set(xlim=(-LEAST / 2, LEAST / 2), ylim=(-LEAST / 2, LEAST / 2))
    figure.legend(*floor.get_legend_handles_labels(), loc="outside lower center", ncols=3,
                  frameon=False, fontsize=8.5)  # fmt: skip
    return figure
