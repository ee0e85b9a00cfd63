"""The figures of a set of scored cases, by class of cases too, with their intervals."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from buggy_rl.diagnosis.search.posterior import EVEN
from buggy_rl.proof.cases.equivalents import expected
from buggy_rl.proof.score.outcome import NAMELESS, ScoredCase
from buggy_rl.proof.score.statistics import (
    Figure,
    bootstrapped,
    calibration,
    calibration_error,
    middle,
    selective_accuracy,
    share,
    written,
)

Value = TypeVar("Value", float, bool)
Test = Callable[[ScoredCase], bool]

CLOSE = 0.1  # relative error of a number that counts as right
NATS = (10, 30, 100, 300, 1000, 10_000)  # [nats] bounds of the classes of detectability


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


class Count(NamedTuple):
    """A share that is counted: the figure of a `ScoreRow`."""

    name: str
    among: Test
    """Whether a case is one of those that are counted."""
    hit: Test
    target: float | None = None
    most: bool = False


def shares(counts: Iterable[Count], outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    """Each share with its interval."""
    return [
        ScoreRow(c.name, share([c.hit(o) for o in outcomes if c.among(o)]), c.target, c.most)
        for c in counts
    ]


def family(*names: str) -> Test:
    """Whether a case is of one of these families."""
    return lambda o: o.case.family in names


def decidable(*names: str) -> Test:
    """Likewise, and decidable or without an oracle's fit."""
    return lambda o: o.case.family in names and o.decidable is not False


def says(verdict: str) -> Test:
    """Whether an answer has this verdict."""
    return lambda o: o.answer.verdict == verdict


def says_a_name(o: ScoredCase) -> bool:
    """Whether an effect has more than half of the probability."""
    return any(p > EVEN for p in o.answer.probable.values())


def says_a_wrong_name(o: ScoredCase) -> bool:
    """Whether one that is not concealed has."""
    return any(p > EVEN and e not in o.case.truth for e, p in o.answer.probable.items())


def first_right(o: ScoredCase) -> bool:
    """Whether the most probable effect is right, and it is said that effects are missing."""
    return o.most_probable_right and o.answer.verdict not in NAMELESS


def _right(o: ScoredCase) -> bool:
    return o.right


def _exact(o: ScoredCase) -> bool:
    return o.exact


def _another_form(o: ScoredCase) -> bool:
    """Nothing is concealed, and yet simulator and car differ, which no baseline shows."""
    return o.case.family == "nothing" and o.case.unknown


def _one_unseen(o: ScoredCase) -> bool:
    return o.case.family == "one" and o.case.differs_unseen


SEARCHED = (  # of a posterior
    Count("one effect: first name right", family("one"), first_right),
    Count("one effect: and nothing else said", family("one"), _exact),
    Count("two effects: exact set", family("two"), _exact),
    Count("three effects: exact set", family("three"), _exact),
    Count("true set fitted (one, two, three)", family("one", "two", "three"), lambda o: o.fitted),
    Count(
        "nothing: a name above 0.5",
        lambda o: o.case.family == "nothing" and not o.case.unknown,
        says_a_name,
    ),
    Count("no effect describes it: a name above 0.5", family("unknown"), says_a_name),
    Count("no effect describes it: called unknown", family("unknown"), says("unknown_physics")),
    Count("no effect describes it: called nothing", family("unknown"), says("no_mismatch")),
    Count(
        "another form, no baseline, nothing concealed: a name above 0.5",
        _another_form,
        says_a_name,
    ),
    Count(
        "another form, no baseline, nothing concealed: called unknown",
        _another_form,
        says("unknown_physics"),
    ),
    Count(
        "another form, no baseline, one effect: most probable name right",
        _one_unseen,
        lambda o: o.most_probable_right,
    ),
    Count(
        "another form, no baseline, one effect: a wrong name above 0.5",
        _one_unseen,
        says_a_wrong_name,
    ),
    Count(
        "one effect, all others: first name right",
        lambda o: o.case.family == "one" and not o.case.differs_unseen,
        first_right,
    ),
)
NAMING = (  # of a diagnosis: right names
    Count("first name right, decidable single effects", decidable("one"), _right, 0.9),
    Count(
        "  of them, plant of the simulator's own make",
        lambda o: decidable("one")(o) and o.case.own_make,
        _right,
        0.97,
    ),
    Count("  right group, decidable single effects", decidable("one"), lambda o: o.group_right),
    Count("first name right, all single effects", family("one"), _right),
    Count("exact set, two effects", family("two"), _exact, 0.75),
    Count("  of them, both decidable", decidable("two"), _exact),
    Count("exact set, three effects", family("three"), _exact),
)
OUTSIDE = (  # effects outside the library, and false positives
    Count("called unknown where nothing is", family("nothing"), says("unknown_physics")),
    Count(
        f"named with confidence above {EVEN:g}, outside the library",
        family("unknown"),
        lambda o: o.sure_and_wrong,
        0.05,
        True,
    ),
    Count("called unknown, outside the library", family("unknown"), says("unknown_physics"), 0.85),
)
UNDECIDED = (  # cases that the drives cannot decide, and manoeuvres that do
    Count(
        "undecidable, answered so",
        lambda o: o.case.family == "one" and o.decidable is False,
        says("cannot_tell"),
        0.8,
    ),
    Count(
        "manoeuvre asked for decides, single effects",
        lambda o: o.case.family == "one" and o.decided is not None,
        lambda o: bool(o.decided),
        0.8,
    ),
    Count("decidable, answered 'cannot tell'", decidable("one"), says("cannot_tell")),
    Count("crashed or timed out", lambda o: True, lambda o: o.answer.status != "answered"),
    Count("could not be weighed", lambda o: True, lambda o: bool(o.failed)),
)


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
    """By what -> class -> share of first names that are right, of single effects."""
    false_positives: dict[str, Figure]
    """By nuisance, of cases in which nothing is concealed."""
    confusion: dict[str, Counter]
    """What was true -> what was named first -> count."""
    calibration: list[tuple[float, float, int]]
    coverage: list[tuple[float, float]]
    failing: list[ScoredCase]
    single: list[ScoredCase]
    """Those with one effect, one by one."""

    def lines(self) -> list[str]:
        """The score in plain text."""
        found = [
            f"{row.name:58} {written(row.figure, row.percent):>28}  n = {row.figure.count:4}"
            + ("" if row.met is None else "  met" if row.met else "  NOT MET")
            for row in self.rows
        ]
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
    """Those of one family."""
    return [o for o in outcomes if o.case.family == name]


def passed(o: ScoredCase) -> bool:
    """Whether an answer needs no entry among the failing cases."""
    verdict = o.answer.verdict
    if o.answer.status != "answered":
        return False
    if o.case.family == "unknown":
        return verdict == "unknown_physics" and not o.sure_and_wrong
    if o.case.family == "nothing":
        return o.right and verdict != "unknown_physics"
    if o.case.family == "one":
        return o.right or (o.decidable is False and verdict == "cannot_tell")
    return o.exact


def claims(outcomes: Iterable[ScoredCase]) -> list[tuple[float, bool]]:
    """Confidence of each first name, and whether it is right."""
    return [
        (first.confidence, o.right if o.case.truth else False)
        for o in outcomes
        if (first := o.answer.first) is not None
    ]


def _rows(outcomes: Sequence[ScoredCase]) -> list[ScoreRow]:
    seconds = middle([o.answer.seconds for o in outcomes if o.answer.seconds])
    error = bootstrapped(claims(outcomes), calibration_error)
    return [
        *shares(NAMING, outcomes),
        *_false_positives(of(outcomes, "nothing")),
        *shares(OUTSIDE, outcomes),
        ScoreRow("expected calibration error", error, 0.05, True, percent=False),
        *_numbers(outcomes),
        *shares(UNDECIDED, outcomes),
        ScoreRow("seconds a case, median", seconds, percent=False),
    ]


def _false_positives(nothing: Sequence[ScoredCase]) -> list[ScoreRow]:
    named = [("something named where nothing is", 0.02, nothing)]
    named += [(f"  {name}", 0.05, same) for name, same in classes(nothing, KEYS["nuisance"])]
    return [
        ScoreRow(name, share([bool(o.answer.said) for o in same]), most, True)
        for name, most, same in named
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
    found: dict[str, Counter] = {}
    for o in outcomes:
        if len(o.case.truth) > 1:
            continue
        true = o.case.truth[0] if o.case.truth else "nothing"
        first, answer = o.answer.first, o.answer
        said = first.name if first else answer.verdict or answer.status
        found.setdefault(true, Counter())[said] += 1
    return dict(sorted(found.items()))
