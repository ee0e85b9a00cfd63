"""Drives: histograms, filtered signals, rollout segments, manoeuvres, before and after a repair."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from tensordict import TensorDictBase

from buggy_rl.figures.style import COLOURS, FAINT, INPUT_LABELS, MEASURED_COLOUR, tidy
from buggy_rl.recordings.windows import model_inputs

REPLAY_SIZE = 4.2, 6.6  # [inch]
SHAPE = 0.62  # height of the path's axes over their width
MARGIN = 0.6  # of the measured extent, by which a diverging simulation may leave the axes
LEAST_EXTENT = 0.3  # [m, m/s, rad/s] extent of axes, at least
COMMANDS = ("throttle", "#b9851b"), ("steering", COLOURS[4])


@dataclass(frozen=True)
class ReplayedSegment:
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


def replay_figure(replay: ReplayedSegment) -> Figure:
    """Path above, channels below, one legend at the foot."""
    figure = Figure(figsize=REPLAY_SIZE, layout="constrained")
    axes = figure.subplots(4, 1, height_ratios=[2.0, 1.25, 1.25, 0.8])
    for name, motion, style in _lines(replay):
        axes[0].plot(motion[:, 0], motion[:, 1], label=name, **style)
        axes[1].plot(replay.time, motion[:, 3], **style)
        axes[2].plot(replay.time, motion[:, 5], **style)
    axes[0].plot(0, 0, "o", color=MEASURED_COLOUR, mfc="white", ms=5, zorder=6)
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


def _lines(replay: ReplayedSegment):
    yield (
        "measured",
        replay.measured,
        {"color": MEASURED_COLOUR, "lw": 2.6, "alpha": 0.55, "zorder": 2},
    )
    yield "simulated", _finite(replay.simulated), {"color": COLOURS[0], "lw": 1.5, "zorder": 3}
    if replay.repaired is not None:
        style = {"color": COLOURS[1], "lw": 1.5, "ls": (0, (4, 1.6)), "zorder": 4}
        yield "repaired", _finite(replay.repaired), style


def _finite(motion: np.ndarray) -> np.ndarray:
    """Gaps in the line where a simulator is not finite."""
    return np.where(np.isfinite(motion), motion, np.nan)


def _limits(replay: ReplayedSegment, column: int) -> tuple[float, float]:
    """Limits around all lines of a column, but no further from the measured one than `MARGIN`."""
    own = replay.measured[:, column]
    low, high = float(own.min()), float(own.max())
    margin = MARGIN * max(high - low, LEAST_EXTENT)
    drawn = np.concatenate([_finite(motion)[:, column] for _, motion, _ in _lines(replay)])
    low = max(low - margin, min(low, float(np.nanmin(drawn))))
    high = min(high + margin, max(high, float(np.nanmax(drawn))))
    middle, half = (low + high) / 2, 0.55 * max(high - low, LEAST_EXTENT)
    return middle - half, middle + half


def _limit_path(axis: Axes, replay: ReplayedSegment) -> None:
    """One scale for both directions."""
    ends = [_limits(replay, column) for column in (0, 1)]
    (x, y), (width, height) = zip(*((sum(e) / 2, e[1] - e[0]) for e in ends), strict=True)
    width = max(width, height / SHAPE)
    half = width / 2, SHAPE * width / 2
    axis.set(xlim=(x - half[0], x + half[0]), ylim=(y - half[1], y + half[1]))
    axis.set_box_aspect(SHAPE)
    axis.axhline(0, color=FAINT, lw=0.5, zorder=1)


RATES = ("d vx / dt [m/s²]", "d vy / dt [m/s²]", "d yaw rate / dt [rad/s²]")


@dataclass(frozen=True)
class PlottedSignals:
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


def signals_figure(signals: PlottedSignals) -> Figure:
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


BINS = 60  # of each histogram; at 7 m/s a bin is 0.1 m/s


def histogram_figure(parts: Mapping[str, TensorDictBase]) -> Figure:
    """Histograms of `velocity` and `action` [*] of each part, the first one filled."""
    figure, axes = plt.subplots(1, 5, figsize=(15, 3), constrained_layout=True)
    filled = {"histtype": "stepfilled", "alpha": 0.35, "color": COLOURS[1]}
    for index, (name, data) in enumerate(parts.items()):
        style = {"histtype": "step", "color": COLOURS[0]} if index else filled
        rows = model_inputs(data).flatten(0, -2)
        for axis, label, values in zip(axes, INPUT_LABELS, rows.unbind(-1), strict=True):
            axis.hist(values.numpy(), BINS, density=True, label=name, **style)
            axis.set_xlabel(label)
            axis.set_yticks([])
            axis.spines[["top", "right", "left"]].set_visible(False)
    axes[0].set_ylabel("share of the rows")
    axes[0].legend(frameon=False, fontsize=8)
    return figure


BUNDLE_HORIZONS = 1.0, 2.0  # [s] of the original study's bundles
QUANTILES = 0.1, 0.5, 0.9
PANEL = 3.3  # [inch]
BEYOND = 0.6  # [m] that a rollout may leave the measured extent by before it is cut off


@dataclass(frozen=True)
class Bundles:
    """N segments of one recording, K instants each."""

    recording: str
    time: NDArray[Any]
    """[K] since the start of each segment [s]."""
    measured: NDArray[Any]
    """[N, K, 3] x, y [m], yaw [rad], world frame."""
    made: Mapping[str, NDArray[Any]]
    """Simulator -> [N, K, 3]."""


def bundles_figure(bundles: Bundles) -> Figure:
    """A column for each simulator: rollouts of 1 s and of 2 s on the floor, then the error."""
    names = list(bundles.made)
    figure = Figure(figsize=(PANEL * len(names), 3.1 * PANEL), layout="constrained")
    axes = figure.subplots(3, len(names), squeeze=False, sharex="row", sharey="row")
    for column, name in enumerate(names):
        colour = COLOURS[column % len(COLOURS)]
        for row, horizon in enumerate(BUNDLE_HORIZONS):
            _draw_floor(axes[row, column], bundles, name, horizon, colour)
        _draw_error(axes[2, column], bundles, name, colour)
        axes[0, column].set_title(name, fontsize=10)
        axes[1, column].set_xlabel("x [m]")
        axes[2, column].set_xlabel("time since the start [s]")
    for row, horizon in enumerate(BUNDLE_HORIZONS):
        axes[row, 0].set_ylabel(f"rollouts of {horizon:g} s\ny [m]")
    axes[2, 0].set_ylabel("position error [m]\nmedian, 10 to 90 %")
    return figure


def _draw_floor(axis: Axes, bundles: Bundles, name: str, horizon: float, colour: str) -> None:
    kept = bundles.time <= horizon + 1e-9
    for path in bundles.measured[:, kept]:
        axis.plot(*path[:, :2].T, color=MEASURED_COLOUR, lw=2.0, alpha=0.45)
    for path in bundles.made[name][:, kept]:
        axis.plot(*path[:, :2].T, color=colour, lw=1.1)
    points = bundles.measured[..., :2].reshape(-1, 2)
    low, high = points.min(0) - BEYOND, points.max(0) + BEYOND
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axis.set_aspect("equal", adjustable="box")
    tidy(axis)


def _draw_error(axis: Axes, bundles: Bundles, name: str, colour: str) -> None:
    off = np.hypot(*np.moveaxis((bundles.made[name] - bundles.measured)[..., :2], -1, 0))
    low, middle, high = np.nanquantile(off, QUANTILES, axis=0)
    axis.fill_between(bundles.time, low, high, color=colour, alpha=0.2, lw=0)
    axis.plot(bundles.time, middle, color=colour, lw=1.8)
    axis.set_ylim(bottom=0)
    tidy(axis)


REPAIR_HORIZONS = ("0.3s", "1s", "3s")
PANELS = {  # quantity of a table's row -> unit
    "position": "position error [m]",
    "yaw": "heading error [rad]",
    "yaw_rate": "yaw rate error, rms [rad/s]",
}


def repair_figure(rows: Sequence[Mapping[str, float | str]]) -> Figure:
    """Errors after 0.3, 1 and 3 s of each simulator, side by side."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    axes = figure.subplots(1, len(PANELS))
    width = 0.8 / len(rows)
    for axis, (quantity, label) in zip(axes, PANELS.items(), strict=True):
        for index, row in enumerate(rows):
            places = [
                at + (index - (len(rows) - 1) / 2) * width for at in range(len(REPAIR_HORIZONS))
            ]
            values = [float(row[f"{quantity}_{horizon}"]) for horizon in REPAIR_HORIZONS]
            axis.bar(places, values, 0.9 * width, color=COLOURS[index], label=row["simulator"])
        axis.set_xticks(
            range(len(REPAIR_HORIZONS)), [h.replace("s", " s") for h in REPAIR_HORIZONS]
        )
        axis.set(xlabel="time since the start", ylabel=label)
        tidy(axis)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, frameon=False
    )
    return figure


MANOEUVRE_SIZE = 8.4, 3.4  # [inch]
CHANNELS = {3: "speed vx [m/s]", 4: "lateral speed vy [m/s]", 5: "yaw rate [rad/s]"}
LEAST_FLOOR = 0.5  # [m] extent of the floor, at least


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
    figure = Figure(figsize=MANOEUVRE_SIZE, layout="constrained")
    axes = figure.subplot_mosaic([["floor", "commands"], ["floor", "telling"]])
    floor, commands, telling = axes["floor"], axes["commands"], axes["telling"]
    column = plan.telling
    for (name, motion), colour in zip(plan.predicted.items(), COLOURS, strict=False):
        floor.plot(motion[:, 0], motion[:, 1], color=colour, lw=1.8, label=f"if {name}")
        telling.plot(plan.time, motion[:, column], color=colour, lw=1.5)
    floor.plot(0, 0, "o", color=MEASURED_COLOUR, mfc="white", ms=7, zorder=6)
    floor.annotate(
        "start", (0, 0), (6, 6), textcoords="offset points", color=MEASURED_COLOUR, fontsize=8
    )
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
    if float(np.ptp(reach, 0).max()) < LEAST_FLOOR:
        floor.set(
            xlim=(-LEAST_FLOOR / 2, LEAST_FLOOR / 2), ylim=(-LEAST_FLOOR / 2, LEAST_FLOOR / 2)
        )
    figure.legend(*floor.get_legend_handles_labels(), loc="outside lower center", ncols=3,
                  frameon=False, fontsize=8.5)  # fmt: skip
    return figure
