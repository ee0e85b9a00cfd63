"""The diagnosis beside other methods: the score of each, and McNemar's test of every pair."""

from collections.abc import Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from buggy_rl.proof.baselines import METHODS
from buggy_rl.proof.ledger import OURS, Entry
from buggy_rl.proof.score.outcome import ScoredCase
from buggy_rl.proof.score.score import Score, score

ALL, ABLE = "all cases", "cases that it can represent"


@dataclass(frozen=True)
class McNemar:
    """Cases in which exactly one of two methods is right."""

    wins: int
    """Cases in which only the first is."""
    losses: int
    """Cases in which only the second is."""

    @property
    def p(self) -> float:
        """Probability of a difference at least as large were both as good: exact, two-sided."""
        one_right = self.wins + self.losses
        return float(binomtest(self.wins, one_right).pvalue) if one_right else 1.0

    @classmethod
    def of(cls, ours: Sequence[bool], theirs: Sequence[bool]) -> "McNemar":
        """Counts, of whether each of two methods is right in the same cases."""
        pairs = [*zip(ours, theirs, strict=True)]
        return cls(sum(a and not b for a, b in pairs), sum(b and not a for a, b in pairs))


@dataclass(frozen=True)
class MethodComparison:
    """The diagnosis and another method on the same cases."""

    method: str
    which: str
    """Cases that are counted, in words."""
    cases: int
    ours: int
    """Cases in which the diagnosis is exactly right."""
    theirs: int
    """Cases in which the method is."""
    crashed: int
    """Cases beside these, in which the method gave no answer; they are not counted."""
    test: McNemar
    given: int
    """Cases in which the names of the diagnosis above one half are right."""
    given_test: McNemar
    """Test of these beside cases in which all that the method names is right."""
    lost: tuple[ScoredCase, ...] = ()
    """What the diagnosis said where the method alone is exactly right."""

    def __str__(self) -> str:
        return (
            f"{self.method}, {self.which}: {self.theirs} of {self.cases} exactly right, "
            f"{self.ours} by the diagnosis; right alone {self.test.losses}, the diagnosis "
            f"{self.test.wins}, McNemar's exact test p = {self.test.p:.2g}; by names above one "
            f"half {self.given}, {self.given_test.losses} to {self.given_test.wins}, "
            f"p = {self.given_test.p:.2g}; crashed {self.crashed}"
        )


def scores_of(entries: Sequence[Entry]) -> dict[str, Score]:
    """Score of each method on the cases that it was asked; the first is that of the diagnosis."""
    methods = dict.fromkeys([OURS, *(method for entry in entries for method in entry.answers)])
    return {
        method: score([entry.scored(method) for entry in entries if method in entry.answers])
        for method in methods
    }


def comparisons(entries: Sequence[Entry]) -> list[MethodComparison]:
    """The diagnosis and each other method: on all cases, and on those that it can represent.

    A case in which the method crashed is left out of both; where the diagnosis crashed, it is not
    right.
    """
    found = []
    for method in METHODS:
        both = [entry for entry in entries if {OURS, method} <= {*entry.answers}]
        if both:
            able = [entry for entry in both if METHODS[method].represents(entry.case)]
            found.append(compared(method, ALL, both))
            found.append(compared(method, ABLE, able))
    return found


def compared(method: str, which: str, entries: Sequence[Entry]) -> MethodComparison:
    """The diagnosis and another method on cases that both were asked.

    Args:
        method: Its name.
        which: What cases these are, in words.
        entries: With the truth.
    """
    answered = [entry for entry in entries if entry.answers[method].status == "answered"]
    ours, theirs = ([entry.scored(name) for entry in answered] for name in (OURS, method))
    exact, given = [o.all_right for o in ours], [o.given_right for o in ours]
    right = [o.all_right for o in theirs]
    lost = (o for o, has, its in zip(ours, exact, right, strict=True) if its and not has)
    return MethodComparison(
        method,
        which,
        cases=len(answered),
        ours=sum(exact),
        theirs=sum(right),
        crashed=len(entries) - len(answered),
        test=McNemar.of(exact, right),
        given=sum(given),
        given_test=McNemar.of(given, right),
        lost=tuple(lost),
    )
