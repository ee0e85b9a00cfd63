"""Rollout segments: path, speed, yaw rate and commands, measured and simulated."""

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from buggy_rl.viz.style import COLOURS, FAINT, MEASURED, tidy

SIZE = 4.2, 6.6  # [inch]
SHAPE = 0.62  # height of the path's axes over their width
MARGIN = 0.6  # of the measured extent, by which a diverging simulation may leave the axes
LEAST = 0.3  # [m, m/s, rad/s] extent of axes, at least
COMMANDS = ("throttle", "#b9851b"), ("steering", COLOURS[4])


@dataclass(frozen=True)
class Replay:
    """A segment with K rows; positions in the frame of the start: x ahead, y left."""

    recording: str
    begin: float
    """[s] since the recording began."""
    why: str
    """What it was chosen for."""
    time: np.ndarray
    """[K] s since the start of the rollout."""
    measured: np.ndarray
    """[K, 6] x, y [m], yaw [rad], vx, vy [m/s], yaw_rate [rad/s]."""
    simulated: np.ndarray
    """[K, 6], not finite where the simulator is not."""
    repaired: np.ndarray | None
    """[K, 6]; None where no effect was named."""
    action: np.ndarray
    """[K, 2] throttle and steering."""


def replay_figure(replay: Replay) -> Figure:
    """Path above, channels below, one legend at the foot."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplots(4, 1, height_ratios=[2.0, 1.25, 1.25, 0.8])
    for name, motion, style in _lines(replay):
        axes[0].plot(motion[:, 0], motion[:, 1], label=name, **style)
        axes[1].plot(replay.time, motion[:, 3], **style)
        axes[2].plot(replay.time, motion[:, 5], **style)
    axes[0].plot(0, 0, "o", color=MEASURED, mfc="white", ms=5, zorder=6)
    axes[0].set(xlabel="x, ahead [m]", ylabel="y, left [m]")
    _limit_path(axes[0], replay)
    axes[1].set(ylabel="speed vx\n[m/s]", ylim=_limits(replay, 3))
    axes[2].set(ylabel="yaw rate\n[rad/s]", ylim=_limits(replay, 5))
    for (name, colour), command in zip(COMMANDS, replay.action.T, strict=True):
        axes[3].plot(replay.time, command, color=colour, lw=1.2, label=name)
    axes[3].set(ylim=(-1.08, 1.08), xlabel="time [s]", ylabel="commands\n[-]")
    for axis in axes[1:3]:
        axis.sharex(axes[3])
        axis.tick_params(labelbottom=False)
    for axis in axes:
        tidy(axis)
    figure.align_ylabels(axes)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8.5)
    return figure


def _lines(replay: Replay):
    yield "measured", replay.measured, {"color": MEASURED, "lw": 2.6, "alpha": 0.55, "zorder": 2}
    yield "simulated", _finite(replay.simulated), {"color": COLOURS[0], "lw": 1.5, "zorder": 3}
    if replay.repaired is not None:
        style = {"color": COLOURS[1], "lw": 1.5, "ls": (0, (4, 1.6)), "zorder": 4}
        yield "repaired", _finite(replay.repaired), style


def _finite(motion: np.ndarray) -> np.ndarray:
    """Gaps in the line where a simulator is not finite."""
    return np.where(np.isfinite(motion), motion, np.nan)


def _limits(replay: Replay, column: int) -> tuple[float, float]:
    """Around all lines of a column, but no further from the measured one than `MARGIN`."""
    own = replay.measured[:, column]
    low, high = float(own.min()), float(own.max())
    margin = MARGIN * max(high - low, LEAST)
    drawn = np.concatenate([_finite(motion)[:, column] for _, motion, _ in _lines(replay)])
    low = max(low - margin, min(low, float(np.nanmin(drawn))))
    high = min(high + margin, max(high, float(np.nanmax(drawn))))
    middle, half = (low + high) / 2, 0.55 * max(high - low, LEAST)
    return middle - half, middle + half


def _limit_path(axis: Axes, replay: Replay) -> None:
    """One scale for both directions."""
    ends = [_limits(replay, column) for column in (0, 1)]
    (x, y), (width, height) = zip(*((sum(e) / 2, e[1] - e[0]) for e in ends), strict=True)
    width = max(width, height / SHAPE)
    half = width / 2, SHAPE * width / 2
    axis.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))
    axis.set_box_aspect(SHAPE)
    axis.axhline(0, color=FAINT, lw=0.5, zorder=1)
