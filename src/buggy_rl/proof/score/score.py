"""The figures of a set of outcomes, by class of cases too, with their intervals."""

import math
import random
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TypeVar

from scipy.stats import binomtest

from buggy_rl.proof.cases.equivalents import expected
from buggy_rl.proof.score.outcome import SURE, ScoredCase

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


Value = TypeVar("Value", float, bool)

CLOSE = 0.1  # relative error of a number that counts as right
NATS = (10, 30, 100, 300, 1000, 10_000)  # [nats] bounds of the classes of detectability


def _detectability(o: ScoredCase) -> str:
    if o.nats is None:
        return "not weighed"
    place = sum(o.nats >= bound for bound in NATS)
    if place in (0, len(NATS)):
        return f"{place}: {'under' if not place else 'above'} {NATS[place and -1]} nats"
    return f"{place}: {NATS[place - 1]} to {NATS[place]} nats"


KEYS: dict[str, Callable[[ScoredCase], str]] = {  # a property of a case -> its class
    "effect": lambda o: o.case.truth[0],
    "pairing": lambda o: o.case.pairing,
    "plant": lambda o: o.case.plant,
    "nuisance": lambda o: o.case.nuisance,
    "size": _detectability,
    "drive length": lambda o: f"{o.case.seconds:g} s",
    "driving": lambda o: o.case.driving,
}


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


@dataclass(frozen=True)
class Score:
    """All figures of one method."""

    rows: list[ScoreRow]
    breakdown: dict[str, dict[str, Figure]]
    """Share of first names that are right, of single effects: by what -> class -> share."""
    false_positives: dict[str, Figure]
    """False positives by nuisance, of cases in which nothing is concealed."""
    confusion: dict[str, Counter]
    """What was true -> what was named first -> count."""
    calibration: list[tuple[float, float, int]]
    coverage: list[tuple[float, float]]
    failing: list[ScoredCase]
    single: list[ScoredCase]
    """Cases with one effect, one by one."""

    def lines(self) -> list[str]:
        """The score in plain text."""
        found = [
            f"{row.name:58} {written(row.figure, row.percent):>28}  n = {row.figure.count:4}"
            + ("" if row.met is None else "  met" if row.met else "  NOT MET")
            for row in self.rows
        ]
        for o in self.failing:
            said = ", ".join(f"{s.name} ({s.confidence:.2f})" for s in o.said) or o.status
            found.append(
                f"{o.case.id}: {'+'.join(o.case.truth) or 'nothing'} -> {o.verdict} {said}"
            )
        return found


def score(outcomes: Sequence[ScoredCase]) -> Score:
    """The score of a method."""
    one = of(outcomes, "one")
    return Score(
        rows=_rows(outcomes),
        breakdown={
            name: {label: share([o.right for o in same]) for label, same in classes(one, key)}
            for name, key in KEYS.items()
        },
        false_positives={
            nuisance: share([bool(o.said) for o in same])
            for nuisance, same in classes(of(outcomes, "nothing"), KEYS["nuisance"])
        },
        confusion=_confusion(outcomes),
        calibration=calibration(claims(outcomes)),
        coverage=selective_accuracy(claims(outcomes)),
        failing=[o for o in outcomes if not passed(o)],
        single=one,
    )


def classes(
    outcomes: Iterable[ScoredCase], key: Callable[[ScoredCase], str]
) -> list[tuple[str, list[ScoredCase]]]:
    """Outcomes of each class, the classes in order."""
    found: dict[str, list[ScoredCase]] = {}
    for o in outcomes:
        found.setdefault(key(o), []).append(o)
    return sorted(found.items())


def of(outcomes: Iterable[ScoredCase], family: str) -> list[ScoredCase]:
    """Cases of one family."""
    return [o for o in outcomes if o.case.family == family]


def passed(o: ScoredCase) -> bool:
    """Whether an answer needs no entry among the failing cases."""
    if o.status != "answered":
        return False
    if o.case.family == "unknown":
        return o.verdict == "unknown_physics" and not o.sure_and_wrong
    if o.case.family == "nothing":
        return o.right and o.verdict != "unknown_physics"
    if o.case.family == "one":
        return o.right or (o.decidable is False and o.verdict == "cannot_tell")
    return exact(o)


def claims(outcomes: Iterable[ScoredCase]) -> list[tuple[float, bool]]:
    """Confidence of each first name, and whether it is right."""
    return [
        (first.confidence, o.right if o.case.truth else False)
        for o in outcomes
        if (first := o.first) is not None
    ]


def _rows(outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    seconds = middle([o.seconds for o in outcomes if o.seconds])
    return [
        *_naming(outcomes),
        *_honesty(outcomes),
        *_numbers(outcomes),
        *_undecided(outcomes),
        ScoreRow("crashed or timed out", share([o.status != "answered" for o in outcomes])),
        ScoreRow("could not be weighed", share([bool(o.failed) for o in outcomes])),
        ScoreRow("seconds a case, median", seconds, percent=False),
    ]


def _naming(outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    """Rows of right names."""
    one = of(outcomes, "one")
    clear = _clear(one)
    own = [o for o in clear if o.case.plant == o.case.simulator]
    two, three = (of(outcomes, family) for family in ("two", "three"))
    return [
        ScoreRow(
            "first name right, decidable single effects", share([o.right for o in clear]), 0.9
        ),
        ScoreRow(
            "  of them, plant of the simulator's own make", share([o.right for o in own]), 0.97
        ),
        ScoreRow("  right group, decidable single effects", share([o.group_right for o in clear])),
        ScoreRow("first name right, all single effects", share([o.right for o in one])),
        ScoreRow("exact set, two effects", share([exact(o) for o in two]), 0.75),
        ScoreRow("  of them, both decidable", share([exact(o) for o in _clear(two)])),
        ScoreRow("exact set, three effects", share([exact(o) for o in three])),
    ]


def _honesty(outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    """False positives, effects outside the library, and calibration."""
    nothing, unknown = of(outcomes, "nothing"), of(outcomes, "unknown")
    alarms, lost = ([o.verdict == "unknown_physics" for o in same] for same in (nothing, unknown))
    sure = f"named with confidence above {SURE:g}, outside the library"
    error = bootstrapped(claims(outcomes), calibration_error)
    named = [("something named where nothing is", 0.02, nothing)]
    named += [(f"  {name}", 0.05, same) for name, same in classes(nothing, KEYS["nuisance"])]
    return [
        *(
            ScoreRow(name, share([bool(o.said) for o in same]), most, True)
            for name, most, same in named
        ),
        ScoreRow("called unknown where nothing is", share(alarms)),
        ScoreRow(sure, share([o.sure_and_wrong for o in unknown]), 0.05, True),
        ScoreRow("called unknown, outside the library", share(lost), 0.85),
        ScoreRow("expected calibration error", error, 0.05, True, percent=False),
    ]


def _numbers(outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    """Errors of the numbers, and the gap that the repair closes."""
    one = of(outcomes, "one")
    sized = [o for o in one if o.right]
    truth, by_oracle = (_known(o.off(by) for o in sized) for by in (False, True))
    error, position = (
        _known(o.closed(metric) for o in [*one, *of(outcomes, "two")])
        for metric in ("error", "position")
    )
    inside = share(_covered(sized))
    return [
        ScoreRow(
            "number within 10 % of the truth, where rightly named",
            share([e <= CLOSE for e in truth]),
        ),
        ScoreRow("  median relative error", middle(truth)),
        ScoreRow("number within 10 % of the oracle's", share([e <= CLOSE for e in by_oracle])),
        ScoreRow("truth inside the 95 % interval", inside, 0.9, ceiling=0.97),
        ScoreRow("median gap closed, of the oracle's", middle(error), 0.95),
        ScoreRow("  in position alone", middle(position)),
        ScoreRow("  at least 95 % closed", share([c >= 0.95 for c in error])),
    ]


def _undecided(outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    """Cases that the drives cannot decide, and manoeuvres that do."""
    one = of(outcomes, "one")
    cannot, could = (
        [o.verdict == "cannot_tell" for o in same]
        for same in ([o for o in one if o.decidable is False], _clear(one))
    )
    decided = _known(o.decided for o in one)
    return [
        ScoreRow("undecidable, answered so", share(cannot), 0.8),
        ScoreRow("manoeuvre asked for decides, single effects", share(decided), 0.8),
        ScoreRow("decidable, answered 'cannot tell'", share(could)),
    ]


def _clear(outcomes: Iterable[ScoredCase]) -> list[ScoredCase]:
    """Decidable ones, and those without an oracle's fit."""
    return [o for o in outcomes if o.decidable is not False]


def exact(o: ScoredCase) -> bool:
    """Whether all that is concealed is named, and nothing else."""
    return o.names == set(o.case.truth) and o.verdict != "unknown_physics"


def _known(values: Iterable[Value | None]) -> list[Value]:
    return [value for value in values if value is not None]


def _covered(outcomes: Iterable[ScoredCase]) -> list[bool]:
    """Whether the true numbers lie between `low` and `high`, one by one."""
    return [
        said.parameters[name]["low"] <= value <= said.parameters[name]["high"]
        for o in outcomes
        for said in o.said
        if said.name in o.case.truth
        for name, value in expected(o.case, said.name).items()
        if name in said.parameters
    ]


def _confusion(outcomes: Iterable[ScoredCase]) -> dict[str, Counter]:
    found: dict[str, Counter] = {}
    for o in outcomes:
        if len(o.case.truth) > 1:
            continue
        true = o.case.truth[0] if o.case.truth else "nothing"
        said = o.first.name if o.first else o.verdict or o.status
        found.setdefault(true, Counter())[said] += 1
    return dict(sorted(found.items()))


def written(figure: Figure, percent: bool = True) -> str:
    """A figure with its interval, such as 95.0 % (88.1 to 98.2)."""
    if not figure.count:
        return "no case"
    scale, unit, digits = (100, " %", 1) if percent else (1, "", 3)
    value, low, high = (scale * v for v in (figure.value, figure.low, figure.high))
    return f"{value:.{digits}f}{unit} ({low:.{digits}f} to {high:.{digits}f})"
