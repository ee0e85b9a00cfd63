"""Development cases: drawn wide, recorded, searched, and all that was seen written down.

One JSON line a case: what is concealed, every hypothesis that was fitted, with its numbers, its
held-out loss by block and its evidence. Nothing here is sealed: a calibration is made from it, and
no published score.
"""

import gzip
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from buggy_rl.core.files import clear_folder, write_json
from buggy_rl.diagnosis.answer.experiments import weak
from buggy_rl.diagnosis.pipeline import open_case
from buggy_rl.diagnosis.run.case import DiagnosisCase as Opened
from buggy_rl.diagnosis.search.joint import JointSearch, joint_search
from buggy_rl.diagnosis.search.observed import search_evidence
from buggy_rl.effects import EFFECTS
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.calibrate import intervals as step_intervals
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import PAIRINGS, DrawConfig, draw_all
from buggy_rl.proof.cases.sealing import HELD_OUT, INPUTS, CaseStore, seal
from buggy_rl.proof.plants import abilities


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
    def file(self) -> Path:
        """File of the ledger."""
        return Path(self.ledger or Path(self.output) / "development.jsonl")


def cases_left(config: DevelopmentConfig) -> list[Case]:
    """Cases of the config that are not in its ledger."""
    plants = {PAIRINGS[name].plant for name in config.draw.pairings}
    cases = draw_all(config.draw, {plant: abilities(plant) for plant in plants})
    done = {entry["case"]["seed"] for entry in entries(config.file)}
    return [case for case in cases if case.seed not in done]


def entries(ledger: Path) -> list[dict[str, Any]]:
    """Lines of a ledger, also of one that is packed (.gz); none where there is no such file.

    Raises:
        ValueError: A line is not a ledger's; the message names file and line.
    """
    if not ledger.exists():
        return []
    found = []
    content = ledger.read_bytes()
    text = (gzip.decompress(content) if ledger.suffix == ".gz" else content).decode()
    for number, line in enumerate(text.splitlines(), 1):
        try:
            entry = json.loads(line)
            if "seed" not in entry["case"] or "hypotheses" not in entry:
                raise KeyError("seed or hypotheses are missing")
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(
                f"{ledger}, line {number}: no development case ({error}); take the line out, and "
                "the case is run again"
            ) from error
        found.append(entry)
    return found


def developed(
    store: CaseStore, effects: Sequence[str], stretches: int, cases: Sequence[Case]
) -> list[dict[str, Any]]:
    """Lines of cases that share plant and length; their drives are removed again.

    Each line is written to its `line_file` too: interrupted, it goes on with the next case.
    """
    store.sealed.mkdir(parents=True, exist_ok=True)
    if not all(line_file(store, case).exists() for case in cases):
        seal(store, cases, list(effects), segments=stretches)  # the batch of a case stays
    for case in cases:
        if not line_file(store, case).exists():
            write_json(line_file(store, case), _line(store, effects, case))
    for case in cases:
        clear_folder(store.inputs(case.id), INPUTS)
        clear_folder(store.held_out(case.id), HELD_OUT)
        store.truth(case.id).unlink(missing_ok=True)
    return [json.loads(line_file(store, case).read_text()) for case in cases]


def line_file(store: CaseStore, case: Case) -> Path:
    """The line of a case that is done, until it is in the ledger."""
    return store.output / "lines" / f"{case.id}.json"


def _line(store: CaseStore, effects: Sequence[str], case: Case) -> dict[str, Any]:
    """What is written of a case that has been driven."""
    begun = time.monotonic()
    try:
        question = open_question(store.inputs(case.id))
        ready = open_case(question.config, question.recordings, question.baseline)
        also = [case.truth] if set(case.truth) <= set(effects or EFFECTS) else []
        found = joint_search(ready.problem, ready.criteria, also)
        line = _described_search(ready, found, case)
        searched = replace(ready, problem=found.problem)
        line["steps"] = step_intervals.step_quantities(searched, found, case)
    except (ValueError, RuntimeError) as error:  # a car that only spins, a drive in pieces
        line = {"failed": f"{type(error).__name__}: {error}", "hypotheses": []}
    seconds = round(time.monotonic() - begun, 1)
    return {"case": asdict(case), "seconds": seconds, **line}


def _described_search(ready: Opened, found: JointSearch, case: Case) -> dict[str, Any]:
    """What is written of a search."""
    driven = [line.partition(" hardly")[0] for line in weak(ready.problem.segments)]
    seen = search_evidence(ready.criteria, found).to_dict()
    return {"rank": found.rank(case.truth), "weak": driven, **seen}
