"""Located error: which velocity, in which conditions, when, how late after commands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from buggy_rl.diagnosis.residuals import charged, drive_features
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.result import SearchResult
from buggy_rl.estimation.rollout import AS_GIVEN, ParameterSets, Simulation
from buggy_rl.estimation.segments import CHANNELS, WARM_UP, Segments

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


def answer_section(case: DiagnosisCase, found: SearchResult) -> Mapping[str, Any]:
    """The part of the answer that says where the simulator as given is wrong."""
    segments = case.problem.segments
    return {"located": locate(case.given, segments, found.noise.sd, case.names)}


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
