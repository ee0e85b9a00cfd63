"""Effects that these recordings cannot tell apart: one finding, with a joint probability.

Hypotheses that differ in one member, and whose predictions differ by little: with whitened
residuals r_A and r_B at their fits and dispersion phi,

    |r_A - r_B|^2 / (2 phi) < deciding_nats,

the nats by which recordings such as these are expected to speak for the one that is true.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from buggy_rl.diagnosis.answer.experiments import SUGGESTED, DecisionRate
from buggy_rl.diagnosis.answer.named_effect import NamedEffect, sentence
from buggy_rl.diagnosis.run.case import DiagnosisCase
from buggy_rl.diagnosis.search.candidate import Candidate
from buggy_rl.diagnosis.search.posterior import LISTED, SURE
from buggy_rl.diagnosis.search.result import SearchResult


@dataclass(frozen=True)
class Equivalents:
    """Effects in each other's place."""

    effects: tuple[str, ...]
    """Effects: that of the best hypothesis, then the others, the most probable first."""
    probability: float
    """Probability of all sets with any of them."""
    shares: tuple[float, ...]
    """Probability of the first, and of each of the others in its place."""
    nats: float
    """Nats by which the predictions of the least alike of them differ from the first one's."""
    sentences: tuple[str, ...]
    """Sentence of each, with its numbers."""
    decided_by: str = ""
    """Manoeuvre that is predicted to decide; empty where none is."""

    def line(self) -> str:
        """The finding in a sentence."""
        each = [f"{e} {p:.0%}" for e, p in zip(self.effects, self.shares, strict=True)]
        text = f"{', '.join(each)}, together {self.probability:.0%}"
        if not self.decided_by:
            text += "; no manoeuvre known here is expected to decide"
        return f"Either {', or '.join(self.sentences)}: these recordings cannot tell [{text}]."

    def to_dict(self) -> dict[str, Any]:
        """Makes its entry in `diagnosis.json`."""
        return {
            "effects": list(self.effects),
            "probability": self.probability,
            "shares": list(self.shares),
            "nats": self.nats,
            "decided_by": self.decided_by,
        }


def equivalents(
    case: DiagnosisCase,
    found: SearchResult,
    named: Sequence[NamedEffect],
    rates: Sequence[DecisionRate],
) -> list[Equivalents]:
    """Named effects that are not sure, with what these recordings cannot tell from them.

    Args:
        case: What was compared.
        found: What a search came to.
        named: Effects that are named.
        rates: How probably each manoeuvre decides, the highest first.
    """
    result, least = [], case.criteria.rules.deciding_nats
    best = rates[0] if rates and rates[0].rate >= SUGGESTED else None
    for effect in named:
        if effect.name not in found.best.effects or effect.confidence >= SURE:
            continue
        others = alike(found, effect.name, least)
        if not others:
            continue
        every = (effect.name, *others)
        shares = found.posterior.in_place_of(effect.name)
        finding = Equivalents(
            effects=every,
            probability=probability_of_any(found, every),
            shares=(effect.confidence, *(shares[other] for other in others)),
            nats=max(others.values()),
            sentences=(effect.sentence, *(_words(case, found, effect.name, o) for o in others)),
            decided_by=best.words if best else "",
        )
        result.append(finding)
    return result


def _words(case: DiagnosisCase, found: SearchResult, effect: str, other: str) -> str:
    """Another effect in the place of one of the best hypothesis, in words."""
    candidate, p = swapped(found, effect, other), case.problem.library.numbers(other)[0]
    assert candidate is not None
    values = candidate.fit.values()[other]
    return sentence(other, values, p.unit, p.value, case.command, case.car_of(other))


def apart(found: SearchResult, one: Candidate, other: Candidate) -> float:
    """Nats by which the predictions of two hypotheses differ."""
    difference = one.fit.whitened - other.fit.whitened
    return float(difference.square().sum() / (2 * found.dispersion))


def swapped(found: SearchResult, effect: str, other: str) -> Candidate | None:
    """The best hypothesis with another effect in the place of one of its own, if it was tried."""
    return found.tried.get(tuple(sorted({*found.best.effects} - {effect} | {other})))


def alike(found: SearchResult, effect: str, least: float) -> dict[str, float]:
    """Effects that cannot be told from one of the best hypothesis -> nats, the most probable first.

    Args:
        found: What a search came to.
        effect: Of its best hypothesis.
        least: Nats from which predictions are told apart.
    """
    result = {}
    for other, probability in found.posterior.in_place_of(effect).items():
        candidate = swapped(found, effect, other)
        if candidate is None or probability < LISTED:
            continue
        nats = apart(found, found.best, candidate)
        if nats < least:
            result[other] = nats
    return result


def probability_of_any(found: SearchResult, effects: Sequence[str]) -> float:
    """Probability of all sets with at least one of some effects."""
    sets = found.posterior.sets.items()
    return min(1.0, sum(p for own, p in sets if {*own} & {*effects}))
