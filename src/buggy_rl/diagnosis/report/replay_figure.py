"""A stretch as pictures: its path, speed and turning, and what was commanded."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from buggy_rl.diagnosis.report.replays import Replay
from buggy_rl.diagnosis.report.style import (
    FAINT,
    MEASURED,
    REPAIRED,
    SIMULATED,
    STEERING,
    THROTTLE,
    tidy,
)

SIZE = 4.2, 6.6  # [inch]
SHAPE = 0.62  # height of the path's picture over its width
ROOM = 0.6  # of the measured extent, by which a simulator that runs away may leave the picture


def replay_figure(replay: Replay) -> Figure:
    """Path above, channels below, one legend at the foot."""
    figure = Figure(figsize=SIZE, layout="constrained")
    axes = figure.subplots(4, 1, height_ratios=[2.0, 1.25, 1.25, 0.8])
    axes[1].sharex(axes[3])
    axes[2].sharex(axes[3])
    for name, motion, style in _lines(replay):
        axes[0].plot(motion[:, 0], motion[:, 1], label=name, **style)
        axes[1].plot(replay.time, motion[:, 3], **style)
        axes[2].plot(replay.time, motion[:, 5], **style)
    axes[0].plot(0, 0, "o", color=MEASURED, mfc="white", ms=5, zorder=6)
    axes[0].set(xlabel="ahead [m]", ylabel="to the left [m]")
    _limit_path(axes[0], replay)
    axes[1].set(ylabel="speed vx\n[m/s]")
    axes[2].set(ylabel="yaw rate\n[rad/s]")
    for axis, column in ((axes[1], 3), (axes[2], 5)):
        axis.set_ylim(*_limits(replay, column, 0.3))
    axes[3].plot(replay.time, replay.action[:, 1], color=STEERING, lw=1.2, label="steering")
    axes[3].plot(replay.time, replay.action[:, 0], color=THROTTLE, lw=1.2, label="throttle")
    axes[3].set(ylim=(-1.08, 1.08), xlabel="time [s]", ylabel="commands\n[-]")
    for axis in axes[1:3]:
        axis.tick_params(labelbottom=False)
    for axis in axes:
        tidy(axis)
    figure.align_ylabels(axes)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=8.5)
    return figure


def _lines(replay: Replay):
    yield "measured", replay.measured, {"color": MEASURED, "lw": 2.6, "alpha": 0.55, "zorder": 2}
    yield "simulated", _finite(replay.simulated), {"color": SIMULATED, "lw": 1.5, "zorder": 3}
    if replay.repaired is not None:
        style = {"color": REPAIRED, "lw": 1.5, "ls": (0, (4, 1.6)), "zorder": 4}
        yield "repaired", _finite(replay.repaired), style


def _finite(motion: np.ndarray) -> np.ndarray:
    """Gaps in the line where a simulator gave no number."""
    return np.where(np.isfinite(motion), motion, np.nan)


def _limits(replay: Replay, column: int, least: float) -> tuple[float, float]:
    """Around what is drawn of a column, but no further from the measured than `ROOM` of it."""
    own = replay.measured[:, column]
    low, high = float(own.min()), float(own.max())
    room = ROOM * max(high - low, least)
    drawn = np.concatenate([_finite(motion)[:, column] for _, motion, _ in _lines(replay)])
    drawn = drawn[np.isfinite(drawn)]
    low = max(low - room, min(low, float(drawn.min())))
    high = min(high + room, max(high, float(drawn.max())))
    middle, half = (low + high) / 2, 0.55 * max(high - low, least)
    return middle - half, middle + half


def _limit_path(axis: Axes, replay: Replay) -> None:
    """One scale for both directions."""
    ends = [_limits(replay, column, 0.3) for column in (0, 1)]
    (x, y), (width, height) = zip(*((sum(e) / 2, e[1] - e[0]) for e in ends), strict=True)
    width = max(width, height / SHAPE)
    half = width / 2, SHAPE * width / 2
    axis.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))
    axis.set_box_aspect(SHAPE)
    axis.axhline(0, color=FAINT, lw=0.5, zorder=1)
