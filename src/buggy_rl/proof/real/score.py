"""Figures of edited recordings: what is named above one half, rightly and wrongly, by class."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from buggy_rl.diagnosis.search.posterior import EVEN
from buggy_rl.proof.ledger import Entry
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.score.answers import StrengthRow, WeighedAnswer, named_curve
from buggy_rl.proof.score.figures import (
    Figure,
    ScoreRow,
    clustered_share,
    lines_of,
)
from buggy_rl.proof.score.outcome import ScoredCase, by_cluster
from buggy_rl.proof.score.score import classes, of
from buggy_rl.proof.score.strength import STRENGTHS, VISIBLE


@dataclass(frozen=True)
class RealOutcome:
    """A case beside its answer, and how strongly each of its effects shows."""

    scored: ScoredCase[RealCase]
    strength: Mapping[str, float]
    """Effect -> nats; empty where it was not weighed."""
    changed: Mapping[str, float] = field(default_factory=dict)
    """Effect -> nats of second evidence, beside what differs from block to block."""

    @classmethod
    def of(cls, entry: Entry) -> "RealOutcome":
        """What a line that was opened comes to."""
        weighed = entry.weighed
        return cls(entry.scored(), weighed.get("strength", {}), weighed.get("changed", {}))

    @property
    def case(self) -> RealCase:
        """The case."""
        return self.scored.case

    @property
    def sure(self) -> frozenset[str]:
        """What is named above one half."""
        said = self.scored.answer.said
        return frozenset(effect.effect for effect in said if effect.confidence > EVEN)

    @property
    def first_sure(self) -> bool:
        """Whether the first name is right and above one half."""
        first = self.scored.answer.first
        return first is not None and first.confidence > EVEN and first.effect in self.case.truth

    @property
    def wrong(self) -> frozenset[str]:
        """What is named above one half and is not concealed."""
        return self.sure - {*self.case.truth}

    @property
    def weakest(self) -> float | None:
        """Strength of the effect that shows least [nats]; None where none was weighed."""
        return min(self.strength.values(), default=None)

    @property
    def least_changed(self) -> float | None:
        """Least strength of an effect by the second evidence [nats]; None where none was told."""
        return min(self.changed.values(), default=None)


@dataclass(frozen=True)
class VisibleEffect:
    """A concealed effect that is strong enough to be found, beside what the answer says of it."""

    outcome: RealOutcome
    effect: str
    nats: float

    @property
    def named(self) -> bool:
        """Whether it is named above one half."""
        return self.effect in self.outcome.sure

    @property
    def first(self) -> bool:
        """Whether it comes first in the answer, however sure, beside unknown physics too."""
        said = self.outcome.scored.answer.said
        return bool(said) and said[0].effect == self.effect


@dataclass(frozen=True)
class RealScore:
    """All figures."""

    rows: list[ScoreRow]
    classes: dict[str, dict[str, list[Figure]]]
    """Property -> class -> first name right and above one half; a wrong name above one half."""
    strengths: list[StrengthRow]
    cases: int
    unknown: int
    """Cases with an edit that no effect describes."""
    names: int
    """Names above one half."""
    effects: int
    """Effects that are concealed, of which the strength is known."""
    visible: list[VisibleEffect]
    """Concealed effects that are strong enough to be found, in the order of their cases."""
    wrong: list[RealOutcome]
    """Every answer with a wrong name above one half."""

    def lines(self) -> list[str]:
        """The figures in plain text."""
        return lines_of(self.rows)


KEYS: dict[str, Callable[[RealOutcome], str]] = {  # a property of a case with one edit -> its class
    "edit": lambda o: o.case.truth[0],
    "dataset": lambda o: o.case.dataset,
    "simulator": lambda o: o.case.engine,
    "baseline": lambda o: "given" if o.case.baseline else "not given",
    "strength": lambda o: strength_class(o.weakest),
}


def strength_class(nats: float | None) -> str:
    """Class of a strength, numbered in its order."""
    if nats is None:
        return "not weighed"
    place = sum(nats >= bound for bound in STRENGTHS[1:])
    if place == 0:
        return "0: below 0 nats"
    if place == len(STRENGTHS) - 1:
        return f"{place}: above {STRENGTHS[place]:g} nats"
    return f"{place}: {STRENGTHS[place]:g} to {STRENGTHS[place + 1]:g} nats"


def real_score(outcomes: Sequence[RealOutcome]) -> RealScore:
    """The score of all that was opened."""
    one = _of(outcomes, "one")
    return RealScore(
        rows=_rows(outcomes),
        classes={
            name: {label: _both(same) for label, same in _classes(one, key)}
            for name, key in KEYS.items()
        },
        strengths=named_curve(
            [WeighedAnswer(o.scored, dict(o.strength)) for o in outcomes], STRENGTHS
        ),
        cases=len(outcomes),
        unknown=len(_of(outcomes, "unknown")),
        names=sum(len(o.sure) for o in outcomes),
        effects=sum(len(o.strength) for o in outcomes),
        visible=[
            VisibleEffect(o, effect, nats)
            for o in outcomes
            for effect, nats in o.strength.items()
            if nats >= VISIBLE
        ],
        wrong=[o for o in outcomes if o.wrong],
    )


def _of(outcomes: Sequence[RealOutcome], family: str) -> list[RealOutcome]:
    wanted = {id(scored) for scored in of([o.scored for o in outcomes], family)}
    return [o for o in outcomes if id(o.scored) in wanted]


def _classes(
    outcomes: Sequence[RealOutcome], key: Callable[[RealOutcome], str]
) -> list[tuple[str, list[RealOutcome]]]:
    return classes(outcomes, key)  # type: ignore[arg-type]


def _both(outcomes: Sequence[RealOutcome]) -> list[Figure]:
    return [_share(outcomes, hit) for hit in (_first_sure, _misnamed)]


def _row(
    name: str,
    outcomes: Sequence[RealOutcome],
    hit: Callable[[RealOutcome], bool],
    target: float | None = None,
    most: bool = False,
) -> ScoreRow:
    return ScoreRow(name, _share(outcomes, hit), target, most)


def _share(outcomes: Sequence[RealOutcome], hit: Callable[[RealOutcome], bool]) -> Figure:
    return clustered_share(by_cluster(outcomes, lambda o: [hit(o)]))


def _rows(outcomes: Sequence[RealOutcome]) -> list[ScoreRow]:
    one, two, outside, nothing = (
        _of(outcomes, name) for name in ("one", "two", "unknown", "nothing")
    )
    visible = [o for o in one if (o.weakest or 0.0) >= VISIBLE]
    changed = [o for o in one if (o.least_changed or 0.0) >= VISIBLE]
    sure = "first name right and above one half"
    found = [
        _row(f"one edit: {sure}", one, _first_sure),
        _row("  first name right, however sure", one, lambda o: o.scored.right),
        _row(f"one edit above {VISIBLE:g} nats: {sure}", visible, _first_sure, 0.85),
        _row(f"  above {VISIBLE:g} nats of second evidence", changed, _first_sure),
        _row("one edit: a wrong name above one half", one, _misnamed, 0.05, True),
        _row("two edits: both named above one half", two, lambda o: o.sure >= {*o.case.truth}),
        _row("  one of them at least", two, lambda o: bool(o.sure & {*o.case.truth})),
        _row("two edits: a wrong name above one half", two, _misnamed),
        _row("unknown edit: a name above one half", outside, _misnamed),
        _row("unknown edit: called unknown", outside, _called_unknown),
    ]
    for given, words in ((True, "with a baseline"), (False, "without one")):
        same = [o for o in nothing if o.case.baseline == given]
        name = f"nothing edited, {words}"
        found += [
            _row(f"{name}: something named above one half", same, _misnamed, 0.05, True),
            _row("  called unknown", same, _called_unknown),
        ]
    return [
        *found,
        _row("crashed or timed out", outcomes, lambda o: o.scored.answer.status != "answered"),
        _row("could not be weighed", outcomes, lambda o: bool(o.scored.failed)),
    ]


def _first_sure(o: RealOutcome) -> bool:
    return o.first_sure


def _misnamed(o: RealOutcome) -> bool:
    return bool(o.wrong)


def _called_unknown(o: RealOutcome) -> bool:
    return o.scored.calls_unknown
