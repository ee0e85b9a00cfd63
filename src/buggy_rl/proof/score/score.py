"""The figures of a set of scored cases, by class of cases too, with their intervals."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from buggy_rl.diagnosis.search.posterior import EVEN
from buggy_rl.proof.cases.equivalents import expected
from buggy_rl.proof.plants.composed import is_composed
from buggy_rl.proof.score.figures import (
    Figure,
    ScoreRow,
    bootstrapped,
    lines_of,
    middle,
    row,
    share,
)
from buggy_rl.proof.score.outcome import ScoredCase
from buggy_rl.proof.score.terms import is_term

BINS = 10
OF_NOTHING = "something named where nothing is"
EQUATION = "an equation"
"""Physics that was composed, and terms that are said, where what was confused is counted."""


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
class Score:
    """All figures of one method."""

    rows: list[ScoreRow]
    breakdown: dict[str, dict[str, Figure]]
    """Share of first names that are right, of single effects: by what -> class -> share."""
    false_positives: dict[str, Figure]
    """Cases in which nothing is concealed and something is said, however improbable, by
    nuisance."""
    confusion: dict[str, Counter]
    """What was true -> what was named first -> count."""
    calibration: list[tuple[float, float, int]]
    coverage: list[tuple[float, float]]
    failing: list[ScoredCase]
    single: list[ScoredCase]
    """Cases with one effect, one by one."""

    def lines(self) -> list[str]:
        """The score in plain text."""
        found = lines_of(self.rows)
        for o in self.failing:
            answer, true = o.answer, "+".join(o.case.truth) or "nothing"
            said = ", ".join(f"{s.name} ({s.confidence:.2f})" for s in answer.said)
            found.append(f"{o.case.id}: {true} -> {answer.verdict} {said or answer.status}")
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
            nuisance: share([bool(o.answer.said) for o in same])
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


def of(outcomes: Iterable[ScoredCase], name: str) -> list[ScoredCase]:
    """Cases of one family."""
    return [o for o in outcomes if o.case.family == name]


def passed(o: ScoredCase) -> bool:
    """Whether an answer needs no entry among the failing cases."""
    if o.answer.status != "answered":
        return False
    if o.case.family == "unknown":
        return o.calls_unknown and not o.sure_and_wrong
    if o.case.family == "nothing":
        return o.right and not o.calls_unknown
    if o.case.family == "one":
        return o.right or (o.decidable is False and o.answer.verdict == "cannot_tell")
    return o.exact


def claims(outcomes: Iterable[ScoredCase]) -> list[tuple[float, bool]]:
    """Confidence of each first name, and whether it is right."""
    return [
        (first.confidence, o.right if o.case.truth else False)
        for o in outcomes
        if (first := o.answer.first) is not None
    ]


def searched_rows(scored: Sequence[ScoredCase]) -> list[ScoreRow]:
    """Shares of posteriors: what is named, and what is called unknown or nothing."""
    one, two, three, outside, nothing = (
        of(scored, name) for name in ("one", "two", "three", "unknown", "nothing")
    )
    forms = [o for o in nothing if o.case.unknown]  # simulator and car differ, and none shows how
    same = [o for o in nothing if not o.case.unknown]
    unseen = [o for o in one if o.case.differs_unseen]
    others = [o for o in one if not o.case.differs_unseen]
    left, form = "no effect describes it", "another form, no baseline"
    return [
        row("one effect: first name right", [o.first_right for o in one]),
        row("one effect: and nothing else said", [o.exact for o in one]),
        row("two effects: exact set", [o.exact for o in two]),
        row("three effects: exact set", [o.exact for o in three]),
        row("true set fitted (one, two, three)", [o.fitted for o in [*one, *two, *three]]),
        row("nothing: a name above 0.5", [bool(o.answer.likely) for o in same]),
        row(f"{left}: a name above 0.5", [bool(o.answer.likely) for o in outside]),
        row(f"{left}: called unknown", [o.calls_unknown for o in outside]),
        row(f"{left}: called nothing", [o.answer.verdict == "no_mismatch" for o in outside]),
        row(f"{form}, nothing concealed: a name above 0.5", [bool(o.answer.likely) for o in forms]),
        row(f"{form}, nothing concealed: called unknown", [o.calls_unknown for o in forms]),
        row(
            f"{form}, one effect: most probable name right",
            [o.most_probable_right for o in unseen],
        ),
        row(
            f"{form}, one effect: a wrong name above 0.5",
            [not o.answer.likely <= {*o.case.truth} for o in unseen],
        ),
        row("one effect, all others: first name right", [o.first_right for o in others]),
    ]


def _rows(outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    """Figures of diagnoses, with their targets."""
    one, two, three, unknown, nothing = (
        of(outcomes, name) for name in ("one", "two", "three", "unknown", "nothing")
    )
    # Those without an oracle's fit count as decidable.
    clear, both = ([o for o in same if o.decidable is not False] for same in (one, two))
    own = [o for o in clear if o.case.own_make]
    cannot, could = (
        [o.answer.verdict == "cannot_tell" for o in same]
        for same in ([o for o in one if o.decidable is False], clear)
    )
    said_of_nothing = [bool(o.answer.said) for o in nothing]
    sure = f"named with confidence above {EVEN:g}, outside the library"
    error = bootstrapped(claims(outcomes), calibration_error)
    seconds = middle([o.answer.seconds for o in outcomes if o.answer.seconds])
    return [
        row("first name right, decidable single effects", [o.right for o in clear], 0.9),
        row("  of them, plant of the simulator's own make", [o.right for o in own], 0.97),
        row("  right group, decidable single effects", [o.group_right for o in clear]),
        row("first name right, all single effects", [o.right for o in one]),
        row("exact set, two effects", [o.exact for o in two], 0.75),
        row("  of them, both decidable", [o.exact for o in both]),
        row("exact set, three effects", [o.exact for o in three]),
        row(f"{OF_NOTHING}, above {EVEN:g}", [o.sure_and_wrong for o in nothing], 0.02, True),
        row(f"{OF_NOTHING}, however improbable", said_of_nothing, 0.02, True),
        row("called unknown where nothing is", [o.calls_unknown for o in nothing]),
        row(sure, [o.sure_and_wrong for o in unknown], 0.05, True),
        row("called unknown, outside the library", [o.calls_unknown for o in unknown], 0.85),
        ScoreRow("expected calibration error", error, 0.05, True, percent=False),
        *_numbers(outcomes),
        row("undecidable, answered so", cannot, 0.8),
        row("manoeuvre asked for decides, single effects", _known(o.decided for o in one), 0.8),
        row("decidable, answered 'cannot tell'", could),
        row("crashed or timed out", [o.answer.status != "answered" for o in outcomes]),
        row("could not be weighed", [bool(o.failed) for o in outcomes]),
        ScoreRow("seconds a case, median", seconds, percent=False),
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
        row("number within 10 % of the truth, where rightly named", [e <= CLOSE for e in truth]),
        ScoreRow("  median relative error", middle(truth)),
        row("number within 10 % of the oracle's", [e <= CLOSE for e in by_oracle]),
        ScoreRow("truth inside the 95 % interval", inside, 0.9, ceiling=0.97),
        ScoreRow("median gap closed, of the oracle's", middle(error), 0.95),
        ScoreRow("  in position alone", middle(position)),
        row("  at least 95 % closed", [c >= 0.95 for c in error]),
    ]


def _known(values: Iterable[Value | None]) -> list[Value]:
    return [value for value in values if value is not None]


def _covered(outcomes: Iterable[ScoredCase]) -> list[bool]:
    """Whether the true numbers lie between `low` and `high`, one by one."""
    return [
        said.parameters[name]["low"] <= value <= said.parameters[name]["high"]
        for o in outcomes
        for said in o.answer.said
        if said.name in o.case.truth
        for name, value in expected(o.case, said.name).items()
        if name in said.parameters
    ]


def _confusion(outcomes: Iterable[ScoredCase]) -> dict[str, Counter]:
    """What was concealed, of one at most -> what was said first; equations are one kind."""
    found: dict[str, Counter] = {}
    for o in outcomes:
        if len(o.case.truth) > 1:
            continue
        true = o.case.truth[0] if o.case.truth else "nothing"
        true = EQUATION if is_composed(true) else true
        first, answer = o.answer.first, o.answer
        said = first.name if first else answer.verdict or answer.status
        said = EQUATION if is_term(said) else said
        found.setdefault(true, Counter())[said] += 1
    return dict(sorted(found.items()))
