"""Cases of a known truth: drawn wide, recorded, searched, and all that was seen written down."""

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from buggy_rl.core.files import clear_folder, write_json
from buggy_rl.diagnosis.answer.experiments import weak
from buggy_rl.diagnosis.pipeline import open_case
from buggy_rl.diagnosis.search.joint import joint_search
from buggy_rl.diagnosis.search.observed import search_evidence
from buggy_rl.effects import EFFECTS
from buggy_rl.jobs import results
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.calibrate.intervals import step_quantities
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig, drawn
from buggy_rl.proof.cases.sealing import HELD_OUT, INPUTS, CaseStore, groups, seal
from buggy_rl.proof.ledger import Entry, Ledger
from buggy_rl.proof.real.case import RealCase


@dataclass(frozen=True)
class DevelopmentConfig(Launching):
    """Cases to calibrate on."""

    output: str = MISSING
    """Folder of prepared simulators, of cases while they are worked on, and of the ledger."""
    draw: DrawConfig = field(default_factory=DrawConfig)
    stretches: int = 48
    """Segments of 1 s that are searched."""
    effects: list[str] = field(default_factory=list)
    """Effects to choose from; empty for the whole library."""
    workers: int = 2
    """Groups of cases at a time."""
    opened: dict[str, str] = field(default_factory=dict)
    """Folder of a run of a proof -> folder of what it sealed: its opened cases are searched, and
    none is drawn. Where the run has a ledger, those in it are opened; else all are."""
    ledger: str = ""
    """File of the lines; empty for OUTPUT/development.jsonl. A case in it is not run again."""

    def __post_init__(self) -> None:
        if self.draw.split != "development":
            raise ValueError("sealed seeds are to be published, nothing is calibrated on them")

    @property
    def store(self) -> CaseStore:
        """Store of the cases while they are worked on."""
        return CaseStore(Path(self.output), Path(self.output) / "truth")

    @property
    def lines(self) -> Ledger:
        """File of the ledger."""
        return Ledger(Path(self.ledger or Path(self.output) / "development.jsonl"))

    @property
    def left(self) -> list[Case]:
        """What is drawn and not in the ledger."""
        return self.lines.left(drawn(self.draw))

    @property
    def left_opened(self) -> dict[CaseStore, list[Any]]:
        """Store of a proof's run -> opened cases that are not in the ledger."""
        found = {}
        for output, sealed in self.opened.items():
            store = CaseStore(Path(output), Path(sealed))
            left = self.lines.left(opened_cases(store))
            # Slow ones last: a run that is stopped has most of the others.
            found[store] = sorted(left, key=lambda case: "mujoco" in case.simulator)
        return found


def opened_cases(store: CaseStore) -> list[Any]:
    """Cases of a proof's run that are open: those in its ledger, or all where it has none.

    Raises:
        ValueError: A case of the ledger is sealed still.
    """
    entries = Ledger(store.output / "ledger.jsonl").entries()
    if entries:
        return [entry.case for entry in entries]
    files = [store.truth(id_) for id_ in sorted(store.digests())]
    drawn_as = [json.loads(file.read_text())["case"] for file in files if file.exists()]
    return [(RealCase if "dataset" in case else Case)(**case) for case in drawn_as]


@dataclass(frozen=True)
class Searching:
    """How cases are searched."""

    store: CaseStore
    """Store in which the cases lie meanwhile."""
    kind: str = "development"
    """Kind of the lines, of `ledger.KINDS`."""
    effects: Sequence[str] = ()
    """Effects to choose from; none for the whole library."""
    stretches: int = 48
    """Segments of 1 s."""
    driven: bool = False
    """Whether the cases lie in the store already, and stay there."""

    def into(
        self, ledger: Ledger, parts: Sequence[Sequence[Case]], workers: int, launching: Launching
    ) -> Iterator[int]:
        """Enters cases in the order in which they are done; how many each time.

        Args:
            ledger: What is in it is whole, whenever this is stopped.
            parts: Cases of one job each.
            workers: Jobs at a time.
            launching: Where.
        """
        calls = {part[0].id: (self, part) for part in parts}
        jobs = self.store.output / "jobs" / "search"
        for lines in results(Searching.searched, calls, jobs, workers, launching):
            entries = [Entry.from_dict(line) for line in lines]
            ledger.enter(entries)
            for entry in entries:
                self._line_file(entry.id).unlink()
            yield len(entries)

    def searched(self, cases: Sequence[Case]) -> list[dict[str, Any]]:
        """Lines of cases that share plant and length; their drives are removed again.

        Each line is written to a file of its own too: interrupted, it goes on with the next case.
        """
        store = self.store
        store.sealed.mkdir(parents=True, exist_ok=True)
        done = all(self._line_file(case.id).exists() for case in cases)
        if not (done or self.driven):
            # The batch of a case stays.
            seal(store, cases, list(self.effects), segments=self.stretches)
        for case in cases:
            if not self._line_file(case.id).exists():
                write_json(self._line_file(case.id), self._entry(case).to_dict())
        if not self.driven:
            for case in cases:
                clear_folder(store.inputs(case.id), INPUTS)
                clear_folder(store.held_out(case.id), HELD_OUT)
                store.truth(case.id).unlink(missing_ok=True)
        return [json.loads(self._line_file(case.id).read_text()) for case in cases]

    def _line_file(self, id_: str) -> Path:
        """The line of a case that is done, until it is in the ledger."""
        return self.store.output / "lines" / f"{id_}.json"

    def _entry(self, case: Case) -> Entry:
        """What is entered of a case that has been driven."""
        begun = time.monotonic()
        kind = "development_real" if isinstance(case, RealCase) else self.kind
        found = Entry(case.id, kind, case)
        try:
            found = self._with_evidence(found)
        except (ValueError, RuntimeError) as error:  # a car that only spins, a drive in pieces
            found = replace(found, failed=f"{type(error).__name__}: {error}")
        return replace(found, seconds=round(time.monotonic() - begun, 1))

    def _with_evidence(self, entry: Entry) -> Entry:
        case = entry.case
        question = open_question(self.store.inputs(case.id))
        ready = open_case(question.config, question.recordings, question.baseline)
        also = [case.truth] if set(case.truth) <= set(self.effects or EFFECTS) else []
        found = joint_search(ready.problem, ready.criteria, also)
        driven = tuple(line.partition(" hardly")[0] for line in weak(ready.problem.segments))
        known = replace(ready, problem=found.problem)
        steps = [] if isinstance(case, RealCase) else step_quantities(known, found, case)
        return replace(
            entry,
            rank=found.rank(case.truth),
            weak=driven,
            evidence=search_evidence(ready.criteria, found),
            steps=tuple(steps),
        )


def parts_of(cases: Sequence[Case], most: int) -> list[list[Case]]:
    """Cases that can be driven in one batch, so many at most."""
    every = groups(cases)
    return [group[i : i + most] for group in every for i in range(0, len(group), most)]
