"""What was said of a case beside what was true."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from buggy_rl.blind_test import baselines
from buggy_rl.blind_test.again import again
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.equivalents import error, expected
from buggy_rl.blind_test.exam import finished, outcome_file
from buggy_rl.blind_test.names import alike, meant
from buggy_rl.blind_test.sealing import Vault

DECIDABLE = 10.0  # [nats] by which the truth must beat what is nearest to it
OURS = "ours"
SURE = 0.5  # confidence above which a name is a claim


@dataclass(frozen=True)
class Said:
    """One effect that was named."""

    name: str
    confidence: float
    parameters: dict[str, dict[str, float]] = field(default_factory=dict)
    """Parameter -> value, low, high."""
    rivals: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """Parameter -> value."""
        return {name: p["value"] for name, p in self.parameters.items()}


@dataclass(frozen=True)
class Outcome:
    """A case, its answer, and what could be known of it."""

    case: Case
    status: str = "answered"
    """answered, crashed or timed out."""
    verdict: str = ""
    said: tuple[Said, ...] = ()
    """As ordered by the tool."""
    suggested: bool = False
    """Whether a manoeuvre was named that would decide."""
    nats: float | None = None
    """By which the true structure beats the simulator as given."""
    margin: float | None = None
    """By which it beats every other single effect, or each of several what lacks it."""
    oracle: dict[str, dict[str, float]] = field(default_factory=dict)
    """Effect -> parameter -> value, of the true structure fitted to the same drives."""
    held_out: dict[str, dict[str, float]] = field(default_factory=dict)
    """as_given, named, oracle -> error, position."""
    seconds: float = 0.0
    """That it took to answer; 0 where nobody looked at the clock."""
    failed: str = ""
    """Why it could not be weighed."""
    decided: bool | None = None
    """Whether the manoeuvre that was asked for led to the right name; None where none was."""

    def to_dict(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Outcome":
        """The inverse of `to_dict`."""
        said = tuple(Said(**{**s, "rivals": tuple(s["rivals"])}) for s in content["said"])
        return cls(**{**content, "case": Case.from_dict(content["case"]), "said": said})

    @property
    def names(self) -> frozenset[str]:
        """What was named, a simulator's own parameter as the effect that it is."""
        return frozenset(meant(s.name) for s in self.said)

    @property
    def first(self) -> Said | None:
        """The first name; none where the tool says that it does not know it."""
        return self.said[0] if self.said and self.verdict != "unknown_physics" else None

    @property
    def right(self) -> bool:
        """Whether the first name is of what is concealed; nothing, where nothing is."""
        if not self.case.truth:
            return self.status == "answered" and not self.said
        return self.first is not None and meant(self.first.name) in self.case.truth

    @property
    def group_right(self) -> bool:
        """Whether the first name is at least one of the same group."""
        first = self.first
        return first is not None and any(alike(first.name, true) for true in self.case.truth)

    @property
    def sure_and_wrong(self) -> bool:
        """Whether anything is claimed that is not there."""
        return any(s.confidence > SURE and meant(s.name) not in self.case.truth for s in self.said)

    @property
    def decidable(self) -> bool | None:
        """Whether the drives hold the answer; None where nobody has looked."""
        return None if self.margin is None else self.margin >= DECIDABLE

    def off(self, by_oracle: bool = False) -> float | None:
        """Relative error of the first right name's numbers, by the truth or the oracle's fit.

        None where nothing is rightly named, without a number, or as a parameter of the simulator's
        own: that is another number in another unit.
        """
        for said in self.said:
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


def gathered(vault: Vault) -> dict[str, list[Outcome]]:
    """All cases that have an outcome, by who answered; opens the sealed answers.

    The tool's own stand under `OURS`; those of other methods come from `baselines.json` beside its
    answer, where there is one: name of the method -> an answer in the form of `diagnosis.json`.
    """
    found: dict[str, list[Outcome]] = {OURS: []}
    for case in vault.cases():
        folder = vault.said(case.id)
        if finished(folder):
            about = json.loads(outcome_file(folder).read_text())
            answer, weighed = {}, {}
            if about["status"] == "answered":
                answer = json.loads((folder / "diagnosis.json").read_text())
            if vault.is_weighed(case.id):
                weighed = json.loads(vault.weighed(case.id).read_text())
            own = outcome(case, about, answer, weighed)
            found[OURS].append(replace(own, decided=_decided(vault, case)))
            if (folder / baselines.FILE).exists():
                # What a method repairs is its own: the tool's held-out error is not.
                bare = {**weighed, "held_out": {}}
                for method, other in json.loads((folder / baselines.FILE).read_text()).items():
                    about = {"status": "answered", "seconds": other.get("seconds", 0.0)}
                    done = outcome(case, about, other, bare)
                    found.setdefault(method, []).append(done)
    return found


def _decided(vault: Vault, case: Case) -> bool | None:
    folder = vault.said(again(case))
    if not finished(folder):
        return None
    about, answer = json.loads(outcome_file(folder).read_text()), {}
    if about["status"] == "answered":
        answer = json.loads((folder / "diagnosis.json").read_text())
    second = outcome(case, about, answer, {})
    return second.right and second.verdict != "cannot_tell"


def outcome(
    case: Case, about: Mapping[str, Any], answer: Mapping[str, Any], weighed: Mapping[str, Any]
) -> Outcome:
    """From what lies on the disk.

    Args:
        case: The truth.
        about: `outcome.json` of the exam: status and seconds.
        answer: `diagnosis.json`, or what a baseline says in the same form; empty after a crash.
        weighed: From the oracle; may be empty.
    """
    rivals = weighed.get("rivals")
    nats = weighed.get("nats")
    if rivals is not None and nats is not None:
        rivals = {**rivals, "": nats}  # nothing at all is a rival too
    return Outcome(
        case=case,
        status=about["status"],
        verdict=answer.get("verdict", ""),
        said=tuple(_said(effect) for effect in answer.get("effects", [])),
        suggested=bool(answer.get("excitation", {}).get("suggest")),
        nats=nats,
        margin=min(rivals.values()) if rivals else None,
        oracle=weighed.get("parameters", {}),
        held_out=weighed.get("held_out", {}),
        seconds=about["seconds"],
        failed=weighed.get("failed", ""),
    )


def _said(effect: Mapping[str, Any]) -> Said:
    rivals: Sequence[Mapping[str, Any]] = effect.get("confused_with", [])
    return Said(
        name=effect["name"],
        confidence=effect["confidence"],
        parameters={
            name: {k: p[k] for k in ("value", "low", "high")}
            for name, p in effect.get("parameters", {}).items()
        },
        rivals=tuple(r["name"] for r in rivals),
    )
