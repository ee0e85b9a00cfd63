"""Residuals: where simulator and drives part, and what no effect explains of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from buggy_rl.estimation.evidence import NO_BASELINE, BaselineMisfit, misfit
from buggy_rl.estimation.gauss_newton import Problem
from buggy_rl.estimation.rollout import AS_GIVEN, ParameterSets, Simulation
from buggy_rl.estimation.segments import CHANNELS, WARM_UP, Segments

STEERED = 0.1  # [s] over which the rate of the steering command is taken
SHORT = 0.3  # [s] within which an error stays where it began
LARGE = 50.0  # times the noise, as which a change of a residual counts at most
FEATURE_BINS = 6  # of each feature, with equal shares of the data
OVERDUE = 1.6  # a region's share of the error over its share of the data, to be worth a mention
ENOUGH = 0.04  # share of the data that a region must hold
MOST_REGIONS = 4
MOST_LAG = 0.4  # [s] after a command in which its effect is looked for
LEFT_BY_NOISE = 0.968  # mean of max(2 z^2 - 2, 0) of a standard normal z: 4 phi(1)


@dataclass(frozen=True)
class Region:
    """A part of what was driven, and its shares."""

    where: dict[str, tuple[float, float]]
    error_share: float
    data_share: float

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "where": {feature: list(bounds) for feature, bounds in self.where.items()},
            "error_share": self.error_share,
            "data_share": self.data_share,
        }


@dataclass(frozen=True)
class Interval:
    """A segment of time of one drive."""

    recording: str
    begin: float
    """[s] since the drive began."""
    end: float
    error_share: float

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "recording": self.recording,
            "from": self.begin,
            "to": self.end,
            "error_share": self.error_share,
        }


@dataclass(frozen=True)
class Located:
    """Place of the excess error: its channels, regions, intervals and lags."""

    channel_share: dict[str, float]
    regions: list[Region]
    intervals: list[Interval]
    lags: dict[str, dict[str, float]]
    """Command -> channel -> time [s] after it at which errors follow it most; nan for none."""

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "channel_share": self.channel_share,
            "regions": [region.to_dict() for region in self.regions],
            "intervals": [interval.to_dict() for interval in self.intervals],
            "lags": self.lags,
        }


def drive_features(segments: Segments, instants: Tensor) -> dict[str, Tensor]:
    """What was driven at the instants [N, K], from smoothed measurements."""
    rows = segments.start + instants
    pose, velocity, action = (
        segments.smooth_pose[:, rows],
        segments.smooth_velocity[:, rows],
        segments.action,
    )
    back = max(1, round(STEERED / segments.dt))
    past = action[:, rows - back]
    return {
        "vx": velocity[..., 0],
        "steering": action[:, rows, 1],
        "throttle": action[:, rows, 0],
        "steering_rate": (action[:, rows, 1] - past[..., 1]) / (back * segments.dt),
        "lateral_acceleration": velocity[..., 0] * velocity[..., 2],
        "heading": torch.atan2(torch.sin(pose[..., 2]), torch.cos(pose[..., 2])),
        "elapsed": segments.elapsed[:, None] + rows * segments.dt,
        "x": pose[..., 0],
        "y": pose[..., 1],
    }


def charged(
    simulation: Simulation, segments: Segments, noise: Tensor, settings: ParameterSets = AS_GIVEN
) -> tuple[Tensor, Tensor]:
    """Errors of short rollouts, each instant charged its own.

    How far a velocity's residual changed since the instant before, in noise standard deviations:
    an error is charged where it arises, not where it has grown to.

    Args:
        simulation: Plays into the simulator.
        segments: Segments of drives.
        noise: [6] of a reading.
        settings: One parameter set of the simulator.

    Returns:
        Changes [N, K, 3] of vx, vy and yaw_rate, and the rows [K] after the start they are at.
    """
    fine = replace(simulation, every=max(1, round(SHORT / segments.dt / 3)))
    residual = fine.residuals(segments, settings)[0].double()[..., 3:]  # (N, K, 3)
    change = torch.cat([torch.zeros_like(residual[:, :1]), residual], 1).diff(dim=1) / noise[3:]
    return change.nan_to_num(LARGE).clamp(-LARGE, LARGE), fine.instants(segments)


def locate(
    simulation: Simulation,
    segments: Segments,
    noise: Tensor,
    names: Sequence[str],
    settings: ParameterSets = AS_GIVEN,
) -> Located:
    """Looks for the excess error of short rollouts.

    Error of a channel is the square of what `charged` tells, less what noise alone makes.

    Args:
        simulation: Plays into the simulator.
        segments: Segments of drives.
        noise: [6] of a reading.
        names: Of the drives.
        settings: One parameter set of the simulator.
    """
    change, instants = charged(simulation, segments, noise, settings)
    excess = (change.square() - 2.0).clamp_min(0.0)  # two readings' noise
    of_channel = (excess.mean((0, 1)) - LEFT_BY_NOISE).clamp_min(0.0)  # (3,)
    total = float(of_channel.sum()) or 1.0
    share = {c: float(of_channel[i]) / total for i, c in enumerate(CHANNELS)}
    of_row = excess.sum(-1)  # (N, K)
    seen = drive_features(segments, instants)
    return Located(
        channel_share=share,
        regions=_regions(seen, of_row),
        intervals=_intervals(segments, instants, of_row, names),
        lags=_lags(segments, instants, change),
    )


def _regions(seen: dict[str, Tensor], error: Tensor) -> list[Region]:
    """Boxes of one or two features in which errors are over-represented, the worst first."""
    flat = {name: value.flatten().double().numpy() for name, value in seen.items()}
    weight = error.flatten().numpy()
    total = weight.sum() or 1.0
    masks: dict[str, list[tuple[tuple[float, float], np.ndarray]]] = {}
    for name, value in flat.items():
        edges = np.unique(np.quantile(value, np.linspace(0, 1, FEATURE_BINS + 1)))
        masks[name] = []
        for i in range(len(edges) - 1):
            for j in range(i + 1, min(i + 3, len(edges))):
                low, high = edges[i], edges[j]
                inside = (value >= low) & (value <= high)
                masks[name].append(((float(low), float(high)), inside))
    found = []
    names = list(flat)
    for a, first in enumerate(names):
        for box, inside in masks[first]:
            found.append(_region({first: box}, inside, weight, total))
        for second in names[a + 1 :]:
            for box, inside in masks[first]:
                for other, also in masks[second]:
                    found.append(_region({first: box, second: other}, inside & also, weight, total))
    fit = [r for r in found if r.data_share >= ENOUGH and r.error_share > OVERDUE * r.data_share]
    # Information gained by knowing the region, so that large and dense both count.
    fit.sort(key=lambda r: -r.error_share * np.log(r.error_share / r.data_share))
    chosen: list[Region] = []
    for region in fit:
        if all(set(region.where) != set(c.where) for c in chosen):
            chosen.append(region)
        if len(chosen) == MOST_REGIONS:
            break
    return chosen


def _region(where, inside, weight, total) -> Region:
    return Region(where, float(weight[inside].sum() / total), float(inside.mean()))


def _intervals(segments, instants, error, names) -> list[Interval]:
    """Runs of segments whose error stands out of their drive's, by time."""
    left = LEFT_BY_NOISE * len(CHANNELS) * error.shape[1]
    per = (error.sum(1) - left).clamp_min(0.0)  # (N,)
    total = float(per.sum()) or 1.0
    limit = float(per.mean() + per.std())
    found = []
    for index in per.argsort(descending=True)[:12].tolist():
        if float(per[index]) <= limit:
            break
        begin = float(segments.elapsed[index]) + WARM_UP
        end = begin + float(instants[-1]) * segments.dt
        drive = names[int(segments.recording[index])]
        found.append(Interval(drive, begin, end, float(per[index]) / total))
    found.sort(key=lambda i: (i.recording, i.begin))
    merged: list[Interval] = []
    for item in found:
        last = merged[-1] if merged else None
        if last and last.recording == item.recording and item.begin - last.end < 1.0:
            share = last.error_share + item.error_share
            merged[-1] = Interval(last.recording, last.begin, max(last.end, item.end), share)
        else:
            merged.append(item)
    return sorted(merged, key=lambda i: -i.error_share)


def _lags(segments: Segments, instants: Tensor, change: Tensor) -> dict[str, dict[str, float]]:
    """Lags at which errors follow changes of a command: the largest correlation at a positive lag.

    Commands are differenced first (prewhitened): a held command is like itself at any lag.
    """
    step = segments.action.diff(dim=1, prepend=segments.action[:, :1])  # (N, L, 2)
    rows = segments.start + instants
    most = min(round(MOST_LAG / segments.dt), int(rows[0]))
    result: dict[str, dict[str, float]] = {}
    for command, name in enumerate(("throttle", "steering")):
        result[name] = {}
        for channel, label in enumerate(CHANNELS):
            y = change[..., channel].flatten()
            y = (y - y.mean()).clamp(-5 * y.std(), 5 * y.std())
            best, at = 0.0, float("nan")
            for lag in range(0, most, 2):
                x = step[:, rows - lag, command].flatten().double()
                scale = float((x.square().mean() * y.square().mean()).sqrt())
                r = abs(float((x * y).mean())) / scale if scale > 0 else 0.0
                if r > max(best, 4 / len(y) ** 0.5):
                    best, at = r, lag * segments.dt
            result[name][label] = at
    return result


CONDITION_BINS = 5  # of a condition, with equal shares of the instants
NAMED = 3  # conditions that are named at most
CLIPPED = 25.0  # [noise variances] as which a single reading counts at most
REMEMBERED = 0.3  # [-] correlation of neighbouring instants from which a latent state is likely
READINGS = ("x", "y", "yaw", "vx", "vy", "yaw_rate")


@dataclass(frozen=True)
class Unexplained:
    """What a hypothesis leaves."""

    excess: float
    """Excess misfit."""
    share: float
    """Share of the excess that there was at first."""
    channel: dict[str, float]
    """Share of each channel in it."""
    depends_on: list[str]
    """Conditions that it grows with, the most significant first."""
    memory: bool
    """Whether residuals persist from instant to instant, as those of a latent state do."""
    unclosed: float = 0.0
    """Share of the excess beyond the baseline's that is expected to remain, however little."""


def unexplained(
    problem: Problem,
    before: Tensor,
    after: Tensor,
    depends_share: float,
    usual: BaselineMisfit = NO_BASELINE,
) -> Unexplained:
    """Compares whitened residuals [N, D] before and after a hypothesis.

    Args:
        problem: Its segments and instants.
        before: Of the simulator as given.
        after: Of the hypothesis.
        depends_share: Share of the variance that a condition must explain to be named.
        usual: Excess misfit that counts as none.
    """
    given = before.square().mean(-1)
    first, last = (misfit(w.square().mean(-1), given) - 1 for w in (before, after))
    over = usual.beyond(last)
    readings = after.view(len(after), -1, 6)  # (N, K, 6)
    square = readings.square().clamp_max(CLIPPED)
    of_channel = (square.mean((0, 1)) - 1).clamp_min(0.0)
    total = float(of_channel.sum()) or 1.0
    now, then = readings[:, 1:, 3:].flatten(), readings[:, :-1, 3:].flatten()
    along = float((now * then).mean() / (now.square().mean() + 1e-12))
    return Unexplained(
        excess=last,
        share=last / max(first, last) if last > usual.most else 0.0,
        channel={n: float(v) / total for n, v in zip(READINGS, of_channel.tolist(), strict=True)},
        depends_on=_depends_on(problem, square.sum(-1), depends_share),
        memory=along > REMEMBERED,
        unclosed=over / max(first - usual.mean, over) if over > 0 else 0.0,
    )


def by_condition(problem: Problem, square: Tensor) -> dict[str, float]:
    """Condition -> share of the variance of the squares [N, K] that is between its bins."""
    target = square.flatten().numpy()
    instants = problem.simulation.instants(problem.segments)
    return {
        name: _explained(target, value.flatten().numpy())
        for name, value in drive_features(problem.segments, instants).items()
    }


def _depends_on(problem: Problem, square: Tensor, least: float) -> list[str]:
    """Conditions whose bins explain the squares [N, K], the most significant first."""
    ranked = sorted(by_condition(problem, square).items(), key=lambda item: -item[1])
    return [name for name, share in ranked if share > least][:NAMED]


def _explained(target: NDArray, condition: NDArray) -> float:
    """Share of the target's variance between bins of a condition."""
    edges = np.unique(np.quantile(condition, np.linspace(0, 1, CONDITION_BINS + 1)[1:-1]))
    index = np.digitize(condition, edges)
    means = np.array([target[index == b].mean() for b in np.unique(index)])
    share = np.array([(index == b).mean() for b in np.unique(index)])
    return float((share * (means - target.mean()) ** 2).sum() / (target.var() or 1.0))
