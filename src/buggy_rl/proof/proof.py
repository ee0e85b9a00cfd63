"""A run of the proof: its options, its stages, and what they enter in the ledger.

A case is entered with its answers and the hash of its truth, and opened when it is scored.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from omegaconf import MISSING

from buggy_rl.core.files import write_json
from buggy_rl.jobs import Job, read_outcome, results, run_jobs
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof import baselines
from buggy_rl.proof.baselines import compare, unanswered_methods
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig
from buggy_rl.proof.cases.sealing import (
    CaseStore,
    again,
    drive_again,
    driven_again,
    publish,
    seal,
    suggested_manoeuvres,
    unsealed,
)
from buggy_rl.proof.cases.simulators import prepare, unprepared
from buggy_rl.proof.ledger import OURS, Entry, Ledger
from buggy_rl.proof.score.outcome import CaseAnswer

STATUS = {"done": "answered", "failed": "crashed"}  # status of a job -> of an answer
STAGES = ("prepare", "seal", "ask", "again", "weigh", "compare", "settle", "score", "page")


@dataclass(frozen=True)
class ProofConfig(Launching):
    """Sealed cases, diagnosed and scored."""

    output: str = MISSING
    """Folder of what the diagnosis is given, its answers and the score."""
    sealed: str = ""
    """Folder of what is sealed; empty for OUTPUT_sealed."""
    stages: list[str] = field(default_factory=lambda: list(STAGES))
    """Any of prepare, seal, ask, again, weigh, compare, settle, score, page; done is done."""
    draw: DrawConfig = field(default_factory=DrawConfig)
    effects: list[str] = field(default_factory=list)
    """Effects that the diagnosis chooses from; empty for the whole library."""
    stretches: int = 0
    """Segments of 1 s that are diagnosed; 0 for the diagnosis's own choice."""
    rivals: int = 6
    """Other effects that are fitted to a case to see whether it is decidable."""
    limit: float = 3600.0
    """Time limit of a diagnosis [s]."""
    workers: int = 2
    """Cases at a time."""
    secret: str = "buggy"
    """What the salts of the sealed answers are made from."""
    page: str = ""
    """Markdown file to write; empty for OUTPUT/proof.md."""
    images: str = ""
    """Folder for its pictures; empty for the page's own."""
    opened: str = ""
    """File that counts how often sealed seeds were scored; empty for OUTPUT/opened.json."""
    hashes: str = ""
    """File of the hashes of sealed answers; empty for OUTPUT/hashes.txt."""
    ledger: str = ""
    """File of scored cases, which are not run again; empty for OUTPUT/ledger.jsonl."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.stages) - set(STAGES))
        if unknown:
            raise ValueError(f"no stages {unknown}; available: {', '.join(STAGES)}")

    @property
    def store(self) -> CaseStore:
        """Store of its cases."""
        output = Path(self.output)
        sealed = Path(self.sealed) if self.sealed else Path(f"{output}_sealed")
        return CaseStore(output, sealed, Path(self.hashes) if self.hashes else None)

    @property
    def lines(self) -> Ledger:
        """File of the ledger."""
        return Ledger(Path(self.ledger or self.store.output / "ledger.jsonl"))

    @property
    def counter(self) -> Path:
        """File that counts how often sealed cases were scored."""
        return Path(self.opened or self.store.output / "opened.json")


class ProofStep(NamedTuple):
    """A stage of a run, or a part of one, that runs while its results are read."""

    title: str
    total: int
    """Cases."""
    results: Iterator[tuple[int, str]]
    """Cases done, and what there is to say of them."""


def steps(config: ProofConfig, drawn: Sequence[Case], scripts: Path) -> Iterator[ProofStep]:
    """The stages before `settle`; each is planned when the one before it has run.

    Args:
        config: With the stages that are wanted.
        drawn: All cases of the run; those in the ledger are only published.
        scripts: Folder of `diagnose.py`, `fit_mujoco.py` and `train_models.py`.
    """
    store, stages = config.store, config.stages
    if "seal" in stages:
        publish(store, drawn, config.secret)
    cases = config.lines.left(drawn, store.digests())
    if "prepare" in stages:
        left = unprepared(cases, store.prepared)
        made = ((1, "") for case in left if prepare(case, store.prepared, scripts))
        yield ProofStep("preparing simulators", len(left), made)
    if "seal" in stages:
        options = (config.effects, config.secret, config.stretches)
        yield _parallel(config, "sealing", seal, unsealed(store, cases), *options)
    if "ask" in stages:
        yield _diagnose(config, "diagnosing", [case.id for case in cases], scripts)
    if "again" in stages:
        left = [
            case
            for case in cases
            if not driven_again(store, case) and suggested_manoeuvres(store, case)
        ]
        yield _parallel(config, "driving again", drive_again, left)
        ids = [again(case) for case in cases if store.inputs(again(case)).exists()]
        yield _diagnose(config, "diagnosing again", ids, scripts)
    if "weigh" in stages:
        from buggy_rl.proof.score.oracle import weigh

        left = [case for case in cases if store.diagnosed(case.id) and not store.weighed(case.id)]
        yield _parallel(config, "fitting the truth", weigh, left, config.effects, config.rivals)
    if "compare" in stages:
        left = [case for case in cases if unanswered_methods(store, case)]
        yield _parallel(config, "comparing", compare, left)


def _parallel(config: ProofConfig, title: str, function, items: Sequence, *options) -> ProofStep:
    """Runs a function of a case, or of a group of cases, that returns how many they were."""
    total = sum(1 if isinstance(item, Case) else len(item) for item in items)
    calls = {_named(item): (config.store, item, *options) for item in items}
    folder = config.store.output / "jobs" / function.__name__
    counts = results(function, calls, folder, config.workers, config)
    return ProofStep(title, total, ((count, "") for count in counts))


def _named(item: Case | Sequence[Case]) -> str:
    return item.id if isinstance(item, Case) else item[0].id


def _diagnose(config: ProofConfig, title: str, ids: Sequence[str], scripts: Path) -> ProofStep:
    left = [id_ for id_ in ids if not config.store.diagnosed(id_)]
    jobs = [diagnosis_job(config.store, id_, scripts / "diagnose.py", config.limit) for id_ in left]
    ended = (p.outcome for p in run_jobs(jobs, config.workers, config) if p.outcome)
    messages = (
        "" if o.status == "done" else f"{o.status}: {o.last_words.strip()[-200:]}" for o in ended
    )
    return ProofStep(title, len(left), ((1, text) for text in messages))


def diagnosis_job(store: CaseStore, id_: str, script: Path, limit: float) -> Job:
    """The diagnosis of a case, in the folder of all that it is given; a crash is an outcome."""
    folder = store.diagnosis(id_).resolve()
    command = (str(script.resolve()), "question.yaml", f"output={folder}")
    return Job(id_, folder, command, cwd=store.inputs(id_), limit=limit, final=True)


def answers(store: CaseStore, id_: str) -> dict[str, CaseAnswer]:
    """What was said of a case, by method; the truth is not looked at.

    That of the diagnosis stands under `OURS`. Those of other methods come from `baselines.json`
    beside its answer: name of the method -> an answer in the form of `diagnosis.json`.
    """
    folder = store.diagnosis(id_)
    about = read_outcome(folder)
    about["status"] = STATUS.get(about["status"], about["status"])
    own = {}
    if about["status"] == "answered":
        own = json.loads((folder / "diagnosis.json").read_text())
    found = {OURS: CaseAnswer.from_diagnosis(own, about)}
    file = folder / baselines.FILE
    for method, answer in (json.loads(file.read_text()) if file.exists() else {}).items():
        about = {"status": "answered", "seconds": answer.get("seconds", 0.0)}
        found[method] = CaseAnswer.from_diagnosis(answer, about)
    return found


def asked(store: CaseStore, cases: Sequence[Case], kind: str = "development") -> list[Entry]:
    """Entries, sealed, of those of the cases that have an answer."""
    seals, found = store.digests(), []
    for case in cases:
        if store.diagnosed(case.id):
            second = again(case)
            retold = answers(store, second)[OURS] if store.diagnosed(second) else None
            told = answers(store, case.id)
            found.append(Entry(case.id, kind, seal=seals[case.id], answers=told, again=retold))
    return found


def settle(config: ProofConfig, drawn: Sequence[Case]) -> int:
    """Enters all complete cases; how many.

    Where the stage `compare` is asked for, other methods must have an answer too. They must in any
    case once they have begun: a case in the ledger is not run again, and their answers would be
    lost.
    """
    store, ledger = config.store, config.lines
    compared = "compare" in config.stages or any(
        unanswered_methods(store, case) != [*baselines.METHODS] for case in drawn
    )
    left = [case for case in ledger.left(drawn) if complete(store, case, compared)]
    ledger.enter(asked(store, left, config.draw.split))
    return len(left)


def complete(store: CaseStore, case: Case, compared: bool = True) -> bool:
    """Whether nothing of a case is left to run."""
    return (
        store.weighed(case.id)
        and (store.diagnosed(again(case)) or not suggested_manoeuvres(store, case))
        and not (compared and unanswered_methods(store, case))
    )


def opened(config: ProofConfig, drawn: Sequence[Case]) -> list[Entry]:
    """Entries of the cases that have an answer, by seed; the ledger's own are opened in it."""
    store, ledger = config.store, config.lines
    wanted = {case.id for case in drawn}
    entries = [entry for entry in ledger.entries() if entry.id in wanted]
    sealed = [entry for entry in entries if entry.opened is None]
    for entry in sealed:  # they were complete when they were entered
        if not store.weighed(entry.id):
            file = store.oracle(entry.id)
            raise FileNotFoundError(f"{file} is missing: score case {entry.id} where it was sealed")
    unsealed = [open_entry(store, entry) for entry in sealed]
    if unsealed:
        ledger.replace(unsealed)
    known = {entry.id: entry for entry in [*entries, *unsealed]}
    new = asked(store, [case for case in drawn if case.id not in known], config.draw.split)
    known |= {entry.id: open_entry(store, entry) for entry in new}
    return [known[id_] for id_ in sorted(known)]


def open_entry(store: CaseStore, entry: Entry) -> Entry:
    """An entry with the truth, and what the oracle found."""
    case = store.sealed_case(entry.id, entry.seal)
    weighed = json.loads(store.oracle(case.id).read_text()) if store.weighed(case.id) else {}
    return replace(entry, opened=case, weighed=weighed)


def openings(file: Path) -> int:
    """How often sealed cases were scored: each time is one more chance to tune to them."""
    return json.loads(file.read_text())["opened"] if file.exists() else 0


def open_once(file: Path) -> int:
    """Counts one more; how often that is."""
    count = openings(file) + 1
    write_json(file, {"opened": count})
    return count
