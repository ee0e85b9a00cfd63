"""Figures with their 95 % intervals, and how far confidences are from shares that are right."""

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from scipy.stats import binomtest

RESAMPLES = 2000
BINS = 10


@dataclass(frozen=True)
class Figure:
    """A number with the bounds of its 95 % interval."""

    value: float
    low: float
    high: float
    count: int
    """Cases that it is of."""


NONE = Figure(math.nan, math.nan, math.nan, 0)


def share(hits: Sequence[bool]) -> Figure:
    """Share of hits with Wilson's interval."""
    if not hits:
        return NONE
    found = binomtest(sum(hits), len(hits))
    interval = found.proportion_ci(method="wilson")
    return Figure(found.statistic, float(interval.low), float(interval.high), len(hits))


def middle(values: Sequence[float]) -> Figure:
    """Median with a bootstrap's interval."""
    return bootstrapped(values, median)


def bootstrapped(values: Sequence, statistic) -> Figure:
    """A statistic of a sample, and what 95 % of resamples give; always the same resamples."""
    if not values:
        return NONE
    chance = random.Random(0)
    drawn = sorted(statistic(chance.choices(values, k=len(values))) for _ in range(RESAMPLES))
    low, high = drawn[int(0.025 * RESAMPLES)], drawn[int(0.975 * RESAMPLES) - 1]
    return Figure(statistic(values), low, high, len(values))


def calibration(claims: Sequence[tuple[float, bool]]) -> list[tuple[float, float, int]]:
    """Mean confidence, share that is right, and number, of each tenth that holds any claim."""
    rows = []
    for number in range(BINS):
        inside = [c for c in claims if min(int(c[0] * BINS), BINS - 1) == number]
        if inside:
            said = sum(confidence for confidence, _ in inside) / len(inside)
            rows.append((said, sum(right for _, right in inside) / len(inside), len(inside)))
    return rows


def calibration_error(claims: Sequence[tuple[float, bool]]) -> float:
    """Expected calibration error: mean over claims of |confidence - share right| of their tenth."""
    return sum(n * abs(said - right) for said, right, n in calibration(claims)) / len(claims)


def debiased_calibration_error(claims: Sequence[tuple[float, bool]]) -> float:
    """Root mean square calibration error, without what chance adds in bins of few claims.

    sqrt(sum_b n_b / n ((said_b - right_b)^2 - right_b (1 - right_b) / (n_b - 1))), not below 0;
    tenths with one claim are left out.

    Source: Kumar, Liang & Ma (2019), Verified uncertainty calibration, eq. 5.
    """
    rows = [row for row in calibration(claims) if row[2] > 1]
    total = sum(n for _, _, n in rows)
    squares = sum(n * ((s - r) ** 2 - r * (1 - r) / (n - 1)) for s, r, n in rows)
    return math.sqrt(max(0.0, squares / total)) if total else math.nan


def selective_accuracy(claims: Sequence[tuple[float, bool]]) -> list[tuple[float, float]]:
    """Share of claims kept and share right of those, when only the most confident are kept."""
    ranked = sorted(claims, key=lambda claim: -claim[0])
    rows, right = [], 0
    for count, (confidence, good) in enumerate(ranked, 1):
        right += good
        # Claims of equal confidence are kept together.
        if count == len(ranked) or ranked[count][0] < confidence:
            rows.append((count / len(ranked), right / count))
    return rows


def written(figure: Figure, percent: bool = True, digits: int | None = None) -> str:
    """A figure with its interval, such as 95.0 % (88.1 to 98.2)."""
    if not figure.count:
        return "no case"
    scale, unit, usual = (100, " %", 1) if percent else (1, "", 3)
    digits = usual if digits is None else digits
    value, low, high = (scale * v for v in (figure.value, figure.low, figure.high))
    return f"{value:.{digits}f}{unit} ({low:.{digits}f} to {high:.{digits}f})"


def cell(figure: Figure) -> str:
    """A share in whole per cent with its interval and the number of cases."""
    return f"{written(figure, digits=0)} of {figure.count}" if figure.count else "no cases"
