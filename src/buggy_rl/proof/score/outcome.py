"""The answer to a case, and the answer beside the truth."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

from buggy_rl.diagnosis.search.posterior import EVEN, LISTED, Posterior, certainly_missing
from buggy_rl.proof.cases.case import Concealing
from buggy_rl.proof.cases.equivalents import error, expected, meant, of_same_name, same_group

DECIDABLE = 10.0  # [nats] by which the truth must beat what is nearest to it
Kind = TypeVar("Kind", bound=Concealing)
NAMELESS = ("no_mismatch", "unknown_physics")  # verdicts under which no effect is claimed


@dataclass(frozen=True)
class ScoredEffect:
    """One effect that was named."""

    name: str
    confidence: float
    parameters: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Parameter -> value, low, high."""
    rivals: tuple[str, ...] = ()
    counts_as: str = ""
    """Effect that it stands for; empty for `meant` of its name."""

    @property
    def effect(self) -> str:
        """Effect that the name stands for."""
        return self.counts_as or meant(self.name)

    @property
    def values(self) -> dict[str, float]:
        """Parameter -> value."""
        return {name: p["value"] for name, p in self.parameters.items()}


@dataclass(frozen=True)
class CaseAnswer:
    """What one method said of one case."""

    verdict: str = ""
    said: tuple[ScoredEffect, ...] = ()
    """Effects in the order of the answer."""
    status: str = "answered"
    """answered, crashed or timed out."""
    seconds: float = 0.0
    """Run time [s]; 0 where it was not measured."""
    mentioned: Mapping[str, float] = field(default_factory=dict)
    """Effect -> probability, of all in a posterior; empty where only names are said, and of
    lines of a proof before it was entered."""
    standing: tuple[str, ...] = ()
    """Effects that are said to be missing whatever else is, beside unknown physics."""
    more: float | None = None
    """Probability that more is missing than is named; None where it is not said."""

    @classmethod
    def of(cls, posterior: Posterior) -> "CaseAnswer":
        """What a posterior says; the probability of a parameter is that of the effect of its name.

        A parameter of another name stands for itself: other than in an answer of the diagnosis, it
        is not held for the effect that it amounts to.
        """
        mentioned: dict[str, float] = {}
        for effect in sorted({e for effects in posterior.sets for e in effects}):
            name = of_same_name(effect)
            mentioned[name] = min(1.0, mentioned.get(name, 0.0) + posterior.of(effect))
        if posterior.says == "nothing":
            return cls("no_mismatch", mentioned=mentioned)
        names = sorted({*map(of_same_name, posterior.best)}, key=lambda n: (-mentioned[n], n))
        said = tuple(ScoredEffect(name, mentioned[name], counts_as=name) for name in names)
        if posterior.says == "unknown":
            sure = (
                of_same_name(e)
                for e in posterior.best
                if certainly_missing(posterior.whatever_else(e), posterior.of(e))
            )
            standing = tuple(sorted({*sure}))
            return cls("unknown_physics", said, mentioned=mentioned, standing=standing)
        sure = bool(said) and said[0].confidence >= EVEN
        return cls("missing_physics" if sure else "cannot_tell", said, mentioned=mentioned)

    @classmethod
    def from_diagnosis(cls, answer: Mapping[str, Any], about: Mapping[str, Any]) -> "CaseAnswer":
        """An answer in the form of `diagnosis.json`.

        Args:
            answer: Empty after a crash.
            about: `status` and run time, `seconds`.
        """
        said = tuple(
            ScoredEffect(
                name=effect["name"],
                confidence=effect["confidence"],
                parameters={
                    name: {k: p[k] for k in ("value", "low", "high")}
                    for name, p in effect.get("parameters", {}).items()
                },
                rivals=tuple(rival["name"] for rival in effect.get("confused_with", [])),
            )
            for effect in answer.get("effects", [])
        )
        verdict, more = answer.get("verdict", ""), answer.get("more_is_missing")
        mentioned: dict[str, float] = {}
        for own in answer.get("posterior", {}).get("sets", []):
            for name in {*map(meant, own["effects"])}:
                mentioned[name] = mentioned.get(name, 0.0) + own["probability"]
        mentioned = {name: round(p, 4) for name, p in mentioned.items() if p >= LISTED}
        return cls(verdict, said, about["status"], about["seconds"], mentioned, more=more)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "CaseAnswer":
        """The inverse of `dataclasses.asdict`."""
        said = tuple(
            replace(ScoredEffect(**effect), rivals=tuple(effect["rivals"]))
            for effect in content["said"]
        )
        return replace(cls(**content), said=said, standing=tuple(content["standing"]))

    @property
    def names(self) -> frozenset[str]:
        """Effects that were named, a simulator's own parameter as the effect that it is."""
        return frozenset(effect.effect for effect in self.said)

    @property
    def given(self) -> list[str]:
        """Effects that are named above one half, in the order of the answer."""
        return [effect.effect for effect in self.said if effect.confidence > EVEN]

    @property
    def probable(self) -> Mapping[str, float]:
        """Effect -> probability, of those mentioned; where only names are said, of those."""
        return self.mentioned or {effect.effect: effect.confidence for effect in self.said}

    @property
    def first(self) -> ScoredEffect | None:
        """The first name; none under the verdict `unknown_physics`."""
        return self.said[0] if self.said and self.verdict != "unknown_physics" else None

    @property
    def likely(self) -> frozenset[str]:
        """Effects with more than half of the probability, under any verdict."""
        return frozenset(effect for effect, p in self.probable.items() if p > EVEN)

    @property
    def most_probable(self) -> str:
        """The most probable effect, under any verdict; empty where none is mentioned."""
        return max(self.probable, key=lambda effect: self.probable[effect], default="")


@dataclass(frozen=True)
class ScoredCase(Generic[Kind]):
    """A case, its answer, and what could be known of it."""

    case: Kind
    answer: CaseAnswer = CaseAnswer()
    nats: float | None = None
    """Nats by which the true structure beats the simulator as given."""
    margin: float | None = None
    """Nats by which it beats every other single effect, or each of several what lacks it."""
    oracle: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Effect -> parameter -> value, of the true structure fitted to the same drives."""
    held_out: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """as_given, named, oracle -> error, position."""
    failed: str = ""
    """Why it could not be weighed."""
    decided: bool | None = None
    """Whether the suggested manoeuvre led to the right name; None where none was driven."""
    fitted: bool = False
    """Whether a search came to the true set by itself."""

    @property
    def right(self) -> bool:
        """Whether the first name is of what is concealed; nothing, where nothing is."""
        if not self.case.truth:
            return self.answer.status == "answered" and not self.answer.said
        first = self.answer.first
        return first is not None and first.effect in self.case.truth

    @property
    def group_right(self) -> bool:
        """Whether the first name is at least one of the same group."""
        first = self.answer.first
        return first is not None and any(same_group(first.name, true) for true in self.case.truth)

    @property
    def most_probable_right(self) -> bool:
        """Whether the most probable effect is the only one concealed, under any verdict."""
        return (self.answer.most_probable,) == self.case.truth

    @property
    def first_right(self) -> bool:
        """Whether the most probable effect is right, under a verdict that names effects."""
        return self.most_probable_right and self.answer.verdict not in NAMELESS

    @property
    def calls_unknown(self) -> bool:
        """Whether the verdict is physics that no effect describes."""
        return self.answer.verdict == "unknown_physics"

    @property
    def exact(self) -> bool:
        """Whether all that is concealed is named, and nothing else."""
        return self.answer.names == {*self.case.truth} and not self.calls_unknown

    @property
    def all_right(self) -> bool:
        """Whether exactly what is missing is said: the set, nothing, or unknown physics."""
        if self.case.unknown:
            return self.calls_unknown
        if not self.case.truth:
            return self.answer.verdict == "no_mismatch"
        return self.exact

    @property
    def given_right(self) -> bool:
        """Whether the names above one half are the set that is missing; or unknown physics.

        What the car behaves like, and what is less probable, is not a name that is given.
        """
        if self.case.unknown or self.calls_unknown:
            return self.case.unknown and self.calls_unknown
        return self.answer.status == "answered" and {*self.answer.given} == {*self.case.truth}

    @property
    def sure_and_wrong(self) -> bool:
        """Whether anything is named with confidence that is not concealed."""
        return not {*self.answer.given} <= {*self.case.truth}

    @property
    def decidable(self) -> bool | None:
        """Whether the drives hold the answer; None without an oracle's fit."""
        return None if self.margin is None else self.margin >= DECIDABLE

    def off(self, by_oracle: bool = False) -> float | None:
        """Relative error of the first right name's numbers, by the truth or the oracle's fit.

        None where nothing is rightly named, without a number, or as a parameter of the simulator's
        own: that is another number in another unit.
        """
        for said in self.answer.said:
            if said.name in self.case.truth and said.values:
                truth = expected(self.case, said.name)
                numbers = self.oracle.get(said.name) if by_oracle else truth
                return None if numbers is None else error(said.name, said.values, numbers)
        return None

    def closed(self, metric: str = "error") -> float | None:
        """Share of the gap to the oracle that the repair closes; None where there is no gap.

        (as given - named) / (as given - oracle), on drives that were sealed.
        """
        errors = {name: e[metric] for name, e in self.held_out.items()}
        if "oracle" not in errors or "named" not in errors:
            return None
        gap = errors["as_given"] - errors["oracle"]
        if gap < 0.02 * errors["as_given"]:
            return None  # what is concealed does not show in this metric
        return (errors["as_given"] - errors["named"]) / gap


class Counted(Protocol):
    """What is counted of a case, whatever stands beside its answer."""

    @property
    def scored(self) -> ScoredCase[Any]:
        """The answer beside the truth."""
        ...


Outcome = TypeVar("Outcome", bound=Counted)
Value = TypeVar("Value")


def by_cluster(
    outcomes: Iterable[Outcome], values: Callable[[Outcome], Sequence[Value]]
) -> list[list[Value]]:
    """Values of outcomes, a list for the cases of each cluster."""
    found: dict[str, list[Value]] = {}
    for outcome in outcomes:
        found.setdefault(outcome.scored.case.cluster, []).extend(values(outcome))
    return [*found.values()]
