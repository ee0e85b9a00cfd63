"""The ledger: a line a case, whether it was drawn to calibrate on, to be sealed, or of a benchmark.

A line is JSON. Of a case that was searched it has every hypothesis that was fitted, with its
numbers, its held-out loss by block and its evidence; the answer is computed from that. Of a case
that was sealed it has the answers, and the hash of the truth; the truth and what the oracle found
are in it once it was opened. What is counted of either is a `ScoredCase`.
"""

import gzip
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from buggy_rl.core.files import write_atomically
from buggy_rl.diagnosis.search.case_evidence import CaseEvidence
from buggy_rl.diagnosis.search.posterior import Calibration, Posterior, posterior
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.equivalents import of_same_name
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.score.outcome import CaseAnswer, Kind, ScoredCase

OURS = "ours"
KINDS = {
    "development": "seeds to calibrate on",
    "development_real": "edited recordings of real cars to calibrate on",
    "sealed": "seeds to publish",
    "third": "seeds of the third sealed set",
    "recall": "of benchmarks/recall.py",
    "real": "edited recordings of real cars",
}
SEALED = ("sealed", "third")
"""Kinds of seeds that nothing is calibrated on."""
CASES = {"real": RealCase, "development_real": RealCase}
"""Kind -> class of its cases; `Case` where it is not named."""


@dataclass(frozen=True)
class Entry:
    """A case, and all that was found out about it."""

    id: str
    kind: str = "development"
    """Kind of the line, of `KINDS`."""
    opened: Any = None
    """What was drawn; None while it is sealed."""
    seal: str = ""
    """SHA-256 of what was sealed; empty for a case that never was."""
    seconds: float = 0.0
    """Run time of the search [s]."""
    failed: str = ""
    """Why it could not be searched."""
    evidence: CaseEvidence | None = None
    """What the search saw."""
    rank: int = 0
    """Place of the true set by evidence, from 1; 0 where it was not fitted."""
    weak: tuple[str, ...] = ()
    """What was hardly driven."""
    steps: tuple[Mapping[str, Any], ...] | None = None
    """Quantities of step tests, beside the car's own; None in ledgers from before there were."""
    answers: Mapping[str, CaseAnswer] = field(default_factory=dict)
    """Method -> its answer; that of the diagnosis under `OURS`."""
    again: CaseAnswer | None = None
    """Answer of the diagnosis when the manoeuvre that it asked for was driven too."""
    weighed: Mapping[str, Any] = field(default_factory=dict)
    """What the oracle found, as its file has it: it tells the truth, so it is sealed too."""
    made: Mapping[str, str] = field(default_factory=dict)
    """Commit, time and hash of the source of the diagnosis, and what confined it (`landlock`, or
    `no`); empty in earlier ledgers."""

    @property
    def case(self) -> Any:
        """What was drawn.

        Raises:
            ValueError: It is sealed.
        """
        if self.opened is None:
            raise ValueError(f"case {self.id} is sealed: scripts/prove.py stages=score opens it")
        return self.opened

    @property
    def seen(self) -> CaseEvidence:
        """What the search saw.

        Raises:
            ValueError: It was not searched.
        """
        if self.evidence is None:
            raise ValueError(f"case {self.id} was not searched: {self.failed or 'it was asked'}")
        return self.evidence

    def posterior(self, calibration: Calibration | None = None) -> Posterior:
        """Posterior by the shipped calibration, unless another is given."""
        return posterior(self.seen, calibration)

    def scored(self, said: Posterior | str = OURS) -> ScoredCase:
        """An answer beside the truth.

        Args:
            said: A posterior of what was searched, or the method whose answer was entered.
        """
        if isinstance(said, Posterior):
            sets = {tuple(sorted({*map(of_same_name, h.effects)})) for h in self.seen.fitted}
            return ScoredCase(self.case, CaseAnswer.of(said), fitted=self.case.truth in sets)
        rivals, nats = self.weighed.get("rivals"), self.weighed.get("nats")
        if rivals is not None and nats is not None:
            rivals = {**rivals, "": nats}  # nothing at all is a rival too
        own = said == OURS  # the others are not repaired by, nor asked twice
        return ScoredCase(
            self.case,
            self.answers[said],
            nats=nats,
            margin=min(rivals.values()) if rivals else None,
            oracle=self.weighed.get("parameters", {}),
            held_out=self.weighed.get("held_out", {}) if own else {},
            failed=self.weighed.get("failed", ""),
            decided=self._decided if own else None,
        )

    @property
    def _decided(self) -> bool | None:
        if self.again is None:
            return None
        return ScoredCase(self.case, self.again).right and self.again.verdict != "cannot_tell"

    def to_dict(self) -> dict[str, Any]:
        """Content of the line, without what is empty."""
        line: dict[str, Any] = {"kind": self.kind, "id": self.id, "seal": self.seal}
        line |= {"case": self.opened and asdict(self.opened)}
        line |= {"seconds": self.seconds, "failed": self.failed}
        if self.evidence is not None:
            line |= {"rank": self.rank, "weak": [*self.weak], **self.evidence.to_dict()}
        if self.steps is not None:
            line["steps"] = [dict(step) for step in self.steps]
        line["answers"] = {method: asdict(answer) for method, answer in self.answers.items()}
        line |= {"again": self.again and asdict(self.again), "weighed": dict(self.weighed)}
        line |= {"made": dict(self.made)}
        absent = ("seal", "case", "failed", "answers", "again", "weighed", "made")
        return {name: value for name, value in line.items() if value or name not in absent}

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Entry":
        """Reads a line, also one from before lines had a kind.

        Raises:
            ValueError: It is no line of a ledger.
        """
        plain = ("id", "kind", "seal", "seconds", "failed", "rank", "weighed", "made")
        told = {name: content[name] for name in plain if name in content}
        if "case" in content:
            kind = CASES.get(content.get("kind", ""), Case)
            told["opened"] = kind(**content["case"])
            told["id"] = told["opened"].id
        if content.get("hypotheses"):
            told["evidence"] = CaseEvidence.from_dict(content)
        told |= {name: tuple(content[name]) for name in ("weak", "steps") if name in content}
        if "answers" in content:
            answers, again = content["answers"].items(), content.get("again")
            told["answers"] = {method: CaseAnswer.from_dict(answer) for method, answer in answers}
            told["again"] = again and CaseAnswer.from_dict(again)
        if told.get("kind", "development") not in KINDS:
            raise ValueError(f"no kind {told['kind']!r}; there are {', '.join(KINDS)}")
        if not any(told.get(name) for name in ("failed", "evidence", "answers")):
            raise ValueError("neither searched nor answered")
        return cls(**told)


@dataclass(frozen=True)
class Ledger:
    """Entries in a file, which is made when the first one is entered; what is in it is not redone.

    It may be packed (.gz), to be read.
    """

    file: Path

    def entries(self) -> list[Entry]:
        """All entries; none where there is no such file.

        Raises:
            ValueError: A line is not a ledger's; the message names file and line.
        """
        if not self.file.exists():
            return []
        content, found = self.file.read_bytes(), []
        text = (gzip.decompress(content) if self.file.suffix == ".gz" else content).decode()
        for number, line in enumerate(text.splitlines(), 1):
            try:
                found.append(Entry.from_dict(json.loads(line)))
            except (AttributeError, KeyError, TypeError, ValueError) as error:
                raise ValueError(
                    f"{self.file}, line {number}: no case of a ledger ({error}); take the line "
                    "out, and the case is run again"
                ) from error
        return found

    def left(self, cases: Sequence[Kind], seals: Mapping[str, str] | None = None) -> list[Kind]:
        """Cases that are not entered yet.

        Args:
            cases: What was drawn.
            seals: Case -> SHA-256 of what is sealed of it, as far as known.

        Raises:
            ValueError: An entered case differs: the file is of other settings.
        """
        entered = {entry.id: entry for entry in self.entries()}
        for case in cases:
            entry = entered.get(case.id)
            if entry is None:
                continue
            seal = (seals or {}).get(case.id, entry.seal)
            if entry.opened not in (None, case) or (entry.opened is None and entry.seal != seal):
                raise ValueError(
                    f"{self.file}: case {case.id} was drawn by other settings: use another file"
                )
        return [case for case in cases if case.id not in entered]

    def enter(self, entries: Iterable[Entry]) -> None:
        """Adds entries at the end."""
        self.file.parent.mkdir(parents=True, exist_ok=True)
        with open(self.file, "a") as file:
            file.writelines(map(_line, entries))

    def replace(self, entries: Iterable[Entry]) -> None:
        """Writes entries in place of those of the same cases."""
        new = {entry.id: entry for entry in entries}
        kept = (_line(new.get(entry.id, entry)) for entry in self.entries())
        write_atomically(self.file, "".join(kept))


def _line(entry: Entry) -> str:
    return json.dumps(entry.to_dict()) + "\n"


def answered_by(entries: Sequence[Entry], every: Sequence[Entry] = ()) -> list[str]:
    """Times and code of the diagnoses, and how many of them were confined, in words.

    Args:
        entries: That are counted.
        every: All that were opened, of which the others are said not to be.
    """
    times = sorted(entry.made["time"] for entry in entries if "time" in entry.made)
    if not times:
        return ["the ledger does not say when its cases were diagnosed"]
    commits = sorted({entry.made.get("commit", "unknown")[:7] for entry in entries})
    sources = len({entry.made.get("source") for entry in entries})
    confined = sum(entry.made.get("confined") == "landlock" for entry in entries)
    lines = [
        f"diagnosed from {times[0]} to {times[-1]}, commit{'s' * (len(commits) > 1)} "
        f"{', '.join(commits)}, {sources} state{'s' * (sources > 1)} of the source",
        f"{confined} of {len(entries)} diagnoses could not read what was sealed",
    ]
    if (others := len(every) - len(entries)) > 0:
        lines.append(f"{others} that were opened before, by other code, are not counted")
    return lines


def of_last_code(entries: Sequence[Entry]) -> list[Entry]:
    """Entries that were diagnosed by the same code as the last one.

    Others were opened before the code was changed: they are development cases of this one.
    """
    last = max(entries, key=lambda entry: entry.made.get("time", ""), default=None)
    source = None if last is None else last.made.get("source")
    return [entry for entry in entries if entry.made.get("source") == source]


def searched(ledgers: Iterable[Path]) -> list[Entry]:
    """Entries of ledgers that were searched: what weights and intervals are fitted to.

    Raises:
        ValueError: A line is not a ledger's, or of sealed seeds.
    """
    found = [e for file in ledgers for e in Ledger(file).entries() if e.evidence is not None]
    sealed = [entry.id for entry in found if entry.kind in SEALED]
    if sealed:
        raise ValueError(f"case {sealed[0]} has a sealed seed: nothing is calibrated on those")
    return found
