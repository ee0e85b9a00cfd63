"""The answer to a case beside the truth, and the ledger that keeps a line a case."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from buggy_rl.core.files import write_json
from buggy_rl.jobs import read_outcome
from buggy_rl.proof import baselines
from buggy_rl.proof.baselines import unanswered_methods
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.equivalents import error, expected, meant, same_group
from buggy_rl.proof.cases.sealing import CaseStore, again, suggested_manoeuvres

DECIDABLE = 10.0  # [nats] by which the truth must beat what is nearest to it
OURS = "ours"
SURE = 0.5  # confidence above which a name is a claim
STATUS = {"done": "answered", "failed": "crashed"}  # status of a job -> of an outcome


@dataclass(frozen=True)
class ScoredEffect:
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
class ScoredCase:
    """A case, its answer, and what could be known of it."""

    case: Case
    status: str = "answered"
    """answered, crashed or timed out."""
    verdict: str = ""
    said: tuple[ScoredEffect, ...] = ()
    """Effects in the order of the answer."""
    suggested: bool = False
    """Whether a manoeuvre was named that would decide."""
    nats: float | None = None
    """Nats by which the true structure beats the simulator as given."""
    margin: float | None = None
    """Nats by which it beats every other single effect, or each of several what lacks it."""
    oracle: dict[str, dict[str, float]] = field(default_factory=dict)
    """Effect -> parameter -> value, of the true structure fitted to the same drives."""
    held_out: dict[str, dict[str, float]] = field(default_factory=dict)
    """as_given, named, oracle -> error, position."""
    seconds: float = 0.0
    """Run time [s]; 0 where it was not measured."""
    failed: str = ""
    """Why it could not be weighed."""
    decided: bool | None = None
    """Whether the suggested manoeuvre led to the right name; None where none was driven."""

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "ScoredCase":
        """The inverse of `dataclasses.asdict`."""
        said = tuple(ScoredEffect(**{**s, "rivals": tuple(s["rivals"])}) for s in content["said"])
        return cls(**{**content, "case": Case(**content["case"]), "said": said})

    @property
    def names(self) -> frozenset[str]:
        """What was named, a simulator's own parameter as the effect that it is."""
        return frozenset(meant(s.name) for s in self.said)

    @property
    def first(self) -> ScoredEffect | None:
        """The first name; none under the verdict `unknown_physics`."""
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
        return first is not None and any(same_group(first.name, true) for true in self.case.truth)

    @property
    def sure_and_wrong(self) -> bool:
        """Whether anything is named with confidence that is not concealed."""
        return any(s.confidence > SURE and meant(s.name) not in self.case.truth for s in self.said)

    @property
    def decidable(self) -> bool | None:
        """Whether the drives hold the answer; None without an oracle's fit."""
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


def read_outcomes(store: CaseStore) -> dict[str, list[ScoredCase]]:
    """All cases that have an outcome, by method; reads what is sealed.

    Those of the diagnosis stand under `OURS`. Those of other methods come from `baselines.json`
    beside its answer: name of the method -> an answer in the form of `diagnosis.json`.
    """
    found: dict[str, list[ScoredCase]] = {OURS: []}
    for case in filter(lambda case: store.diagnosed(case.id), store.cases()):
        weighed = {}
        if store.weighed(case.id):
            weighed = json.loads(store.oracle(case.id).read_text())
        found[OURS].append(
            replace(_own(store, case, case.id, weighed), decided=_decided(store, case))
        )
        file = store.diagnosis(case.id) / baselines.FILE
        others = json.loads(file.read_text()) if file.exists() else {}
        for method, answer in others.items():
            about = {"status": "answered", "seconds": answer.get("seconds", 0.0)}
            # The held-out errors are those of the diagnosis, not of the method.
            other = outcome(case, about, answer, {**weighed, "held_out": {}})
            found.setdefault(method, []).append(other)
    return found


def _own(store: CaseStore, case: Case, id_: str, weighed: Mapping[str, Any]) -> ScoredCase:
    folder = store.diagnosis(id_)
    about = read_outcome(folder)
    about["status"] = STATUS.get(about["status"], about["status"])
    answer = {}
    if about["status"] == "answered":
        answer = json.loads((folder / "diagnosis.json").read_text())
    return outcome(case, about, answer, weighed)


def _decided(store: CaseStore, case: Case) -> bool | None:
    if not store.diagnosed(again(case)):
        return None
    second = _own(store, case, again(case), {})
    return second.right and second.verdict != "cannot_tell"


def outcome(
    case: Case, about: Mapping[str, Any], answer: Mapping[str, Any], weighed: Mapping[str, Any]
) -> ScoredCase:
    """Makes a scored case from files.

    Args:
        case: The truth.
        about: Status and run time [s].
        answer: `diagnosis.json`, or a baseline's answer in the same form; empty after a crash.
        weighed: From the oracle; may be empty.
    """
    rivals = weighed.get("rivals")
    nats = weighed.get("nats")
    if rivals is not None and nats is not None:
        rivals = {**rivals, "": nats}  # nothing at all is a rival too
    return ScoredCase(
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


def _said(effect: Mapping[str, Any]) -> ScoredEffect:
    rivals: Sequence[Mapping[str, Any]] = effect.get("confused_with", [])
    return ScoredEffect(
        name=effect["name"],
        confidence=effect["confidence"],
        parameters={
            name: {k: p[k] for k in ("value", "low", "high")}
            for name, p in effect.get("parameters", {}).items()
        },
        rivals=tuple(r["name"] for r in rivals),
    )


@dataclass(frozen=True)
class Ledger:
    """Scored cases in a file, which is made when the first one is entered."""

    file: Path

    def entries(self) -> dict[str, dict[str, ScoredCase]]:
        """Case -> method -> outcome.

        Raises:
            ValueError: A line is not a ledger's; the message names file and line.
        """
        if not self.file.exists():
            return {}
        found = {}
        for number, line in enumerate(self.file.read_text().splitlines(), 1):
            try:
                entry = json.loads(line)
                found[entry["id"]] = {
                    who: ScoredCase.from_dict(content) for who, content in entry["outcomes"].items()
                }
            except (KeyError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{self.file}, line {number}: not a scored case ({error}); take the line out, "
                    "and the case is run again"
                ) from error
        return found

    def open(self, cases: Sequence[Case]) -> list[Case]:
        """Cases that are not entered.

        Raises:
            ValueError: An entered case differs: the file is of other settings.
        """
        entries = self.entries()
        for case in cases:
            if case.id in entries and entries[case.id][OURS].case != case:
                raise ValueError(
                    f"{self.file}: case {case.id} was drawn by other settings: use another file"
                )
        return [case for case in cases if case.id not in entries]

    def settle(self, store: CaseStore, compared: bool = True) -> int:
        """Enters all complete cases of a store; how many.

        With `compared` other methods must have an answer too. They must in any case once they have
        begun: a case in the ledger is not run again, and their answers would be lost.
        """
        entries = self.entries()
        found = read_outcomes(store)
        compared = compared or len(found) > 1
        lines = []
        for own in found[OURS]:
            id_ = own.case.id
            if id_ in entries or not complete(store, own.case, compared):
                continue
            told = {who: asdict(o) for who, each in found.items() for o in each if o.case.id == id_}
            lines.append(json.dumps({"id": id_, "outcomes": told}) + "\n")
        if lines:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with open(self.file, "a") as file:
                file.writelines(lines)
        return len(lines)

    def outcomes(self, store: CaseStore, cases: Sequence[Case]) -> dict[str, list[ScoredCase]]:
        """Outcomes of the cases by method, by case: from the ledger, else from the store."""
        entries = self.entries()
        wanted = {case.id for case in cases}
        found: dict[str, list[ScoredCase]] = {OURS: []}
        for id_ in sorted(wanted & set(entries)):
            for who, outcome in entries[id_].items():
                found.setdefault(who, []).append(outcome)
        for who, others in read_outcomes(store).items():
            new = [o for o in others if o.case.id in wanted and o.case.id not in entries]
            found.setdefault(who, []).extend(new)
        return {who: sorted(each, key=lambda o: o.case.id) for who, each in found.items()}


def complete(store: CaseStore, case: Case, compared: bool = True) -> bool:
    """Whether nothing of a case is left to run."""
    return (
        store.weighed(case.id)
        and (store.diagnosed(again(case)) or not suggested_manoeuvres(store, case))
        and not (compared and unanswered_methods(store, case))
    )


def openings(file: Path) -> int:
    """How often sealed cases were scored: each time is one more chance to tune to them."""
    return json.loads(file.read_text())["opened"] if file.exists() else 0


def open_once(file: Path) -> int:
    """Counts one more; how often that is."""
    count = openings(file) + 1
    write_json(file, {"opened": count})
    return count
