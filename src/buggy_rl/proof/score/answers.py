"""What answers came to: names over strength, terms, what else is missing, and repaired simulators.

A name is given where its probability is above one half. An effect can be found where its strength,
the held-out gain over the best set without it, is 6 nats at least.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from statistics import fmean, median

from buggy_rl.proof.score.figures import (
    Figure,
    ScoreRow,
    clustered,
    clustered_share,
)
from buggy_rl.proof.score.outcome import ScoredCase, by_cluster
from buggy_rl.proof.score.stack import SIMPLER, StackErrors
from buggy_rl.proof.score.strength import VISIBLE
from buggy_rl.proof.score.tables import listed
from buggy_rl.proof.score.terms import TermMatch, is_term

SEVERAL = ("two", "three")
COUNTED = ("nothing", "one", *SEVERAL)
"""Families of which every right name is known."""
SURE = 0.8
"""Probability of more that is missing from which on it is said surely."""
BESIDE = (
    "physics that no effect describes",
    "form: another make, no baseline",
    "form: another make, with a baseline",
    "numbers: own make, parameters off or steps too long",
    "nothing: own make, the car's own parameters",
)
"""What differs between car and simulator beside the effects of the library, the gravest first."""
OFF = ("parameters", "integrator")
"""Nuisances, or what their names begin with, that are the simulator's and not the sensor's."""
AT_SENSOR = "yaw"
"""Place of composed physics that pushes at the sensor, where a term's is at the centre of gravity:
its coefficient is another number."""


@dataclass(frozen=True)
class WeighedAnswer:
    """A case beside its answer, with what can be known of both."""

    scored: ScoredCase
    strength: dict[str, float] = field(default_factory=dict)
    """Effect, or term that is what was composed, -> nats; empty where nothing was weighed."""
    terms: dict[str, TermMatch] = field(default_factory=dict)
    """Terms at the place of what was composed, best ones first; empty where nothing was."""
    stack: StackErrors | None = None

    @property
    def more(self) -> float | None:
        """Probability that more is missing than is named."""
        return self.scored.answer.more

    @property
    def family(self) -> str:
        """Family of the case; what was composed is `term` where the grammar has it."""
        return "term" if self.composed is not None else self.scored.case.family

    @property
    def composed(self) -> TermMatch | None:
        """The term that was composed, if the grammar has it."""
        return next((match for match in self.terms.values() if match.right), None)

    @property
    def answered(self) -> bool:
        """Whether there is an answer: no drive was refused, and nothing crashed."""
        return self.scored.answer.status == "answered"

    @property
    def beside(self) -> str:
        """What differs beside the effects of the library, in words; a kind of `BESIDE`."""
        case = self.scored.case
        if case.family == "unknown":
            return BESIDE[0]
        if not case.own_make:
            return BESIDE[2 if case.baseline else 1]
        return BESIDE[3 if case.nuisance.startswith(OFF) else 4]

    @property
    def given(self) -> list[str]:
        """Effects of the library that are named above one half."""
        return [name for name in self.scored.answer.given if not is_term(name)]

    @property
    def wrong(self) -> list[str]:
        """Effects given that are not concealed."""
        return [name for name in self.given if name not in self.scored.case.truth]

    @property
    def visible(self) -> dict[str, float]:
        """What is concealed and strong enough to be found."""
        return {name: nats for name, nats in self.strength.items() if nats >= VISIBLE}

    @property
    def found_term(self) -> str:
        """Name of a term of the answer that is what was composed; empty where there is none."""
        said = (s.name for s in self.scored.answer.said)
        return next((n for n in said if n in self.terms and self.terms[n].right), "")

    @property
    def covered(self) -> bool | None:
        """Whether the interval of the term that was found holds the coefficient.

        None where no term was found, or its coefficient is another number than that of what was
        composed.
        """
        name = self.found_term
        if not name or self.scored.case.truth[0].startswith(AT_SENSOR):
            return None
        [said] = [s for s in self.scored.answer.said if s.name == name]
        number = said.parameters["coefficient"]
        return number["low"] <= self.terms[name].coefficient <= number["high"]


@dataclass(frozen=True)
class StrengthRow:
    """Effects of at least so many nats, and what is named above one half in their cases."""

    least: float
    """[nats]"""
    recall: Figure
    """Share of the effects that are named."""
    precision: Figure
    """Share of the names that are right, in cases all of whose effects are so strong."""


@dataclass(frozen=True)
class StackRow:
    """Gap between as given and a simulator without fault that is closed, in cases of one kind."""

    family: str
    """Kind, in words."""
    closed: Figure
    """Median share that the repaired simulator closes, on drives that were held out,"""
    retuned: Figure
    """its parameters fitted alone,"""
    residual: Figure
    """and a learned residual alone."""
    beaten: Figure
    """Share of cases in which something simpler is surely nearer."""


@dataclass(frozen=True)
class MoreRow:
    """What is said of more that is missing than is named, in cases of one kind."""

    kind: str
    """What differs, of `BESIDE`."""
    surely: Figure
    """Share of cases in which it is said with `SURE` at least,"""
    hardly: Figure
    """and with less than 1 - `SURE`."""


def answer_rows(cases: Sequence[WeighedAnswer]) -> list[ScoreRow]:
    """Figures with their targets; intervals by clusters of the same car's make and simulator.

    A case without an answer is one in which nothing was found; that nothing wrong was said in it is
    no merit, and is not counted.
    """
    known, terms = [c for c in cases if c.family in COUNTED], of(cases, "term")
    several = [c for c in cases if c.family in SEVERAL]
    nothing, outside, within = (
        [c for c in of(cases, family) if c.answered] for family in ("nothing", "unknown", "term")
    )
    held = clustered_share(by_cluster(terms, lambda c: [] if c.covered is None else [c.covered]))
    return [
        _row("names above one half that are right", known, _right, 0.95),
        _row("  of all cases, with what no effect describes", cases, _right, 0.95),
        _row(
            f"effects above {VISIBLE:g} nats that are named, of one", of(cases, "one"), _seen, 0.9
        ),
        _row("  of two and three", several, _seen, 0.8),
        *_brier_rows(known),
        _row("nothing concealed: something named", nothing, _misnamed),
        _row("in the grammar: term found", [c for c in terms if c.visible], _term_found, 0.8),
        ScoreRow("  its interval holds the coefficient", held, 0.92, ceiling=0.97),
        _row("in the grammar: an effect named", within, _misnamed),
        _row("outside of it: an effect named", outside, _misnamed, 0.05, most=True),
        _row("no answer: a drive refused, or a crash", cases, lambda c: [not c.answered]),
        *_stack_rows(cases),
    ]


def _brier_rows(cases: Sequence[WeighedAnswer]) -> list[ScoreRow]:
    """Brier scores of the names in answers, and of all considered, where lines have them."""

    def row(of: str, squares: Callable[[WeighedAnswer], list[float]]) -> ScoreRow:
        score = clustered(by_cluster(cases, squares), fmean)
        return ScoreRow(f"Brier score {of}", score, 0.06, most=True, percent=False)

    def said(case: WeighedAnswer) -> list[float]:
        named = case.scored.answer.said
        return [(e.confidence - (e.effect in case.scored.case.truth)) ** 2 for e in named]

    def every(case: WeighedAnswer) -> list[float]:
        return [(p - right) ** 2 for p, right in listed(case.scored)]

    rows = [row("of the names in the answer", said)]
    if any(c.scored.answer.mentioned for c in cases):
        rows.append(row("of all names considered", every))
    return rows


def _row(
    name: str,
    cases: Iterable[WeighedAnswer],
    hits: Callable[[WeighedAnswer], list[bool]],
    target: float | None = None,
    most: bool = False,
) -> ScoreRow:
    return ScoreRow(name, clustered_share(by_cluster(cases, hits)), target, most)


def _right(case: WeighedAnswer) -> list[bool]:
    return [name in case.scored.case.truth for name in case.given]


def _seen(case: WeighedAnswer) -> list[bool]:
    return [name in case.given for name in case.visible]


def _misnamed(case: WeighedAnswer) -> list[bool]:
    return [bool(case.wrong)]


def _term_found(case: WeighedAnswer) -> list[bool]:
    return [bool(case.found_term)]


def of(cases: Iterable[WeighedAnswer], family: str) -> list[WeighedAnswer]:
    """Cases of one family."""
    return [case for case in cases if case.family == family]


def named_curve(cases: Sequence[WeighedAnswer], bounds: Sequence[float]) -> list[StrengthRow]:
    """Shares of effects of so many nats that are named, and of names that are right, by bound."""
    known = [c for c in cases if c.family in COUNTED]
    return [_at_least(known, bound) for bound in bounds]


def _at_least(known: Sequence[WeighedAnswer], bound: float) -> StrengthRow:
    named = by_cluster(
        known, lambda c: [name in c.given for name, nats in c.strength.items() if nats >= bound]
    )
    strong = [c for c in known if c.strength and min(c.strength.values()) >= bound]
    right = by_cluster(strong, _right)
    return StrengthRow(bound, clustered_share(named), clustered_share(right))


def _stack_rows(cases: Sequence[WeighedAnswer]) -> list[ScoreRow]:
    return [
        ScoreRow("gap closed on held-out drives, median", _closed(cases, "stack"), 0.9),
        ScoreRow("  by re-tuning alone", _closed(cases, "retuned")),
        ScoreRow("  by a learned residual alone", _closed(cases, "residual")),
        ScoreRow("surely beaten by something simpler", _beaten(cases), 0.0, most=True),
    ]


def _closed(cases: Iterable[WeighedAnswer], what: str) -> Figure:
    closed = by_cluster(cases, lambda c: [c.stack.closed(what)] if c.stack and c.stack.seen else [])
    return clustered(closed, median)


def _beaten(cases: Iterable[WeighedAnswer]) -> Figure:
    return clustered_share(by_cluster(cases, lambda c: [c.stack.beaten] if c.stack else []))


FAMILIES = {
    "nothing": "nothing",
    "one": "one effect",
    "two": "two effects",
    "three": "three effects",
    "term": "an equation of the grammar",
    "unknown": "outside of effects and grammar",
}


def stack_by_family(cases: Iterable[WeighedAnswer]) -> list[StackRow]:
    """Repaired simulators by what was concealed; kinds without a case are left out."""
    weighed = [case for case in cases if case.stack is not None]
    rows = []
    for family, words in FAMILIES.items():
        if same := of(weighed, family):
            closed, retuned, residual = (_closed(same, what) for what in ("stack", *SIMPLER[1:]))
            rows.append(StackRow(words, closed, retuned, residual, _beaten(same)))
    return rows


def more_by_difference(cases: Iterable[WeighedAnswer]) -> list[MoreRow]:
    """What is said of more that is missing, by what differs; kinds without a case are left out."""
    said = [case for case in cases if case.more is not None]
    rows = []
    for kind in BESIDE:
        if own := [case for case in said if case.beside == kind]:
            surely = by_cluster(own, lambda c: [(c.more or 0.0) >= SURE])
            hardly = by_cluster(own, lambda c: [(c.more or 0.0) < 1 - SURE])
            rows.append(MoreRow(kind, clustered_share(surely), clustered_share(hardly)))
    return rows
