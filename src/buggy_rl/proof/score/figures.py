"""Numbers with their 95 % intervals, and the lines of a score that are made of them.

Cases of the same car and simulator share what decides them: their values come in groups, one a
cluster, and intervals are never narrower than those of single values.
"""

import math
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from statistics import NormalDist, median
from typing import TypeVar

from scipy.stats import t

RESAMPLES = 2000
LEVEL = 0.975  # probability below the upper bound of an interval
Value = TypeVar("Value")


@dataclass(frozen=True)
class Figure:
    """A number with the bounds of its 95 % interval; nan where one value tells none."""

    value: float
    low: float
    high: float
    count: int
    """Values that it is of."""


NONE = Figure(math.nan, math.nan, math.nan, 0)


def share(hits: Sequence[bool]) -> Figure:
    """Share of hits with Wilson's interval."""
    return _wilson(sum(hits), len(hits), len(hits)) if hits else NONE


def clustered_share(groups: Sequence[Sequence[bool]]) -> Figure:
    """Share of hits with Wilson's interval of as many independent ones as the clusters are worth.

    n' = n / deff (z / t_{G - 1})^2, n at most; deff = G / (G - 1) sum_g (sum_i (x_gi - p))^2 /
    (n p (1 - p)) by the G clusters g. Where all or none are hits, or there is one cluster, n' = n.

    Source: Korn & Graubard (1998), Confidence intervals for proportions with small expected number
    of positive counts estimated from survey data.
    """
    groups = [group for group in groups if group]
    hits, n, clusters = sum(map(sum, groups)), sum(map(len, groups)), len(groups)
    if not n:
        return NONE
    p, worth = hits / n, float(n)
    if clusters > 1 and 0 < hits < n:
        squares = sum((sum(group) - p * len(group)) ** 2 for group in groups)
        effect = clusters / (clusters - 1) * squares / (n * p * (1 - p))
        narrow = (_normal() / float(t.ppf(LEVEL, clusters - 1))) ** 2
        worth = n * min(1.0, narrow / effect) if effect else worth
    return _wilson(hits, n, worth)


def _wilson(hits: int, count: int, worth: float) -> Figure:
    p, z2 = hits / count, _normal() ** 2
    centre, scale = (p + z2 / (2 * worth)) / (1 + z2 / worth), 1 + z2 / worth
    half = math.sqrt(z2 * (p * (1 - p) / worth + z2 / (4 * worth**2))) / scale
    return Figure(p, max(0.0, centre - half), min(1.0, centre + half), count)


def _normal() -> float:
    return NormalDist().inv_cdf(LEVEL)


def middle(values: Sequence[float]) -> Figure:
    """Median with a bootstrap's interval."""
    return bootstrapped(values, median)


def bootstrapped(values: Sequence, statistic) -> Figure:
    """A statistic of a sample, and what 95 % of resamples give; always the same resamples."""
    return _bootstrapped([[value] for value in values], statistic)


def clustered(groups: Sequence[Sequence], statistic) -> Figure:
    """A statistic of all values, with the wider of intervals over values and over clusters."""
    groups = [group for group in groups if group]
    alone, together = bootstrapped(_all(groups), statistic), _bootstrapped(groups, statistic)
    low, high = min(alone.low, together.low), max(alone.high, together.high)
    return Figure(alone.value, low, high, alone.count)


def _bootstrapped(groups: Sequence[Sequence], statistic) -> Figure:
    if not groups:
        return NONE
    if len(_all(groups)) == 1:
        return Figure(statistic(_all(groups)), math.nan, math.nan, 1)
    chance, count = random.Random(0), len(groups)
    drawn = (chance.choices(groups, k=count) for _ in range(RESAMPLES))
    found = sorted(statistic(_all(some)) for some in drawn)
    low, high = found[round((1 - LEVEL) * RESAMPLES)], found[round(LEVEL * RESAMPLES) - 1]
    return Figure(statistic(_all(groups)), low, high, len(_all(groups)))


def _all(groups: Iterable[Sequence[Value]]) -> list[Value]:
    return [*chain.from_iterable(groups)]


@dataclass(frozen=True)
class ScoreRow:
    """One line of the score."""

    name: str
    figure: Figure
    target: float | None = None
    """Least value, or greatest where `most`."""
    most: bool = False
    percent: bool = True
    ceiling: float | None = None
    """Greatest value, where there is a least one as well."""

    @property
    def met(self) -> bool | None:
        """Whether the target is met; None where there is no target or no case."""
        if self.target is None or not self.figure.count:
            return None
        value = self.figure.value
        if self.ceiling is not None and value > self.ceiling:
            return False
        return value <= self.target if self.most else value >= self.target


def row(
    name: str, hits: Sequence[bool], target: float | None = None, most: bool = False
) -> ScoreRow:
    """A share of cases."""
    return ScoreRow(name, share(hits), target, most)


def lines_of(rows: Sequence[ScoreRow]) -> list[str]:
    """Figures in plain text, and whether they meet their targets."""
    return [
        f"{row.name:64} {written(row.figure, row.percent):>28}  n = {row.figure.count:4}"
        + ("" if row.met is None else "  met" if row.met else "  NOT MET")
        for row in rows
    ]


def written(figure: Figure, percent: bool = True, digits: int | None = None) -> str:
    """A figure with its interval, such as 95.0 % (88.1 to 98.2)."""
    if not figure.count:
        return "no case"
    scale, unit, usual = (100, " %", 1) if percent else (1, "", 3)
    digits = usual if digits is None else digits
    value, low, high = (scale * v for v in (figure.value, figure.low, figure.high))
    if math.isnan(low):
        return f"{value:.{digits}f}{unit}"
    return f"{value:.{digits}f}{unit} ({low:.{digits}f} to {high:.{digits}f})"


def cell(figure: Figure) -> str:
    """A share in whole per cent with its interval and the number of cases."""
    return f"{written(figure, digits=0)} of {figure.count}" if figure.count else "no cases"
