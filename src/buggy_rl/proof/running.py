"""What a run of sealed cases has in common, whatever its cases are: asking, entering, opening.

A case is entered with its answers and the hash of its truth, and opened when it is scored.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from omegaconf import MISSING

from buggy_rl.core.config import made_by
from buggy_rl.core.files import write_json
from buggy_rl.core.kernels import CACHE
from buggy_rl.jobs import Job, read_outcome, results, run_jobs
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof import baselines, confined
from buggy_rl.proof.cases.case import Concealing
from buggy_rl.proof.cases.sealing import CaseStore, again
from buggy_rl.proof.ledger import OURS, Entry, Ledger
from buggy_rl.proof.score.outcome import CaseAnswer

STATUS = {"done": "answered", "failed": "crashed"}  # status of a job -> of an answer
SOURCE = Path(__file__).parents[1]
GENERATOR = Path(__file__).parent
MADE = "made.json"


@dataclass(frozen=True)
class SealedRun(Launching):
    """Place of a run of sealed cases, and how it is run."""

    output: str = MISSING
    """Folder of what the diagnosis is given, its answers and the score."""
    sealed: str = ""
    """Folder of what is sealed; empty for OUTPUT_sealed."""
    limit: float = 3600.0
    """Time limit of a diagnosis [s]."""
    workers: int = 2
    """Cases at a time."""
    page: str = ""
    """Markdown file to write; empty for one in OUTPUT, named after the proof."""
    pages: list[str] = field(default_factory=list)
    """Other Markdown files that get its tables, each between marks (`proof/markdown.py`)."""
    opened: str = ""
    """File that counts how often sealed seeds were scored; empty for OUTPUT/opened.json."""
    hashes: str = ""
    """File of the hashes of sealed answers; empty for OUTPUT/hashes.txt."""
    ledger: str = ""
    """File of scored cases, which are not run again; empty for OUTPUT/ledger.jsonl."""
    confine: bool = True
    """Whether a diagnosis is kept from reading what is `hidden`, by Linux's Landlock."""

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
    def hidden(self) -> list[Path]:
        """What no diagnosis may read: truths, other cases, the ledger, this package's generator.

        Its own folders lie in the first one and are shown to it.
        """
        return [self.store.output, self.store.sealed, self.lines.file, GENERATOR]

    @property
    def kind(self) -> str:
        """Kind of its lines, of `ledger.KINDS`."""
        return "development"

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


def parallel(config: SealedRun, title: str, function, items: Sequence, *options) -> ProofStep:
    """Runs a function of a case, or of a group of cases, that returns how many they were."""
    total = sum(len(item) if isinstance(item, Sequence) else 1 for item in items)
    calls = {_named(item): (config.store, item, *options) for item in items}
    folder = config.store.output / "jobs" / function.__name__
    counts = results(function, calls, folder, config.workers, config)
    return ProofStep(title, total, ((count, "") for count in counts))


def _named(item: Concealing | Sequence[Concealing]) -> str:
    return item[0].id if isinstance(item, Sequence) else item.id


def diagnoses(config: SealedRun, title: str, ids: Sequence[str], script: Path) -> ProofStep:
    """Runs the diagnosis of the cases that have no answer yet; a crash is an answer too.

    Args:
        config: Of the run.
        title: Of the step.
        ids: Names of the cases.
        script: `diagnose.py`.

    Raises:
        ValueError: They cannot be confined here.
    """
    left = [id_ for id_ in ids if not config.store.diagnosed(id_)]
    hidden = _hidden(config) if left else []
    alone = config.workers == 1
    jobs = [diagnosis_job(config.store, id_, script, config.limit, hidden, alone) for id_ in left]
    return ProofStep(title, len(left), _diagnosed(config, jobs))


def _hidden(config: SealedRun) -> list[Path]:
    """What is hidden from diagnoses; nothing where they are not to be confined."""
    if not config.confine:
        return []
    if why := confined.missing():
        raise ValueError(
            f"{why}: what is sealed cannot be hidden from a diagnosis; run on Linux 5.13 or later, "
            "outside a container that forbids Landlock, or give confine=false: the ledger then "
            "says that diagnoses ran openly"
        )
    CACHE.mkdir(parents=True, exist_ok=True)  # of kernels: what is made later cannot be read
    return config.hidden


def _diagnosed(config: SealedRun, jobs: Sequence[Job]) -> Iterator[tuple[int, str]]:
    made = _made(config) if jobs else {}
    for job, _, outcome in run_jobs(jobs, config.workers, config):
        if outcome is None:
            continue
        write_json(job.folder / MADE, {**made, "time": datetime.now(UTC).isoformat("T", "seconds")})
        said = outcome.last_words.strip()[-200:]
        yield 1, "" if outcome.status == "done" else f"{outcome.status}: {said}"


def _made(config: SealedRun) -> dict[str, str]:
    by = "landlock" if config.confine else "no"
    return {"commit": made_by()["commit"], "source": source_digest(), "confined": by}


def source_digest() -> str:
    """SHA-256 of the package's own modules and their YAML files, by name and content."""
    digest = hashlib.sha256()
    for file in sorted([*SOURCE.rglob("*.py"), *SOURCE.rglob("*.yaml")]):
        digest.update(f"{file.relative_to(SOURCE)}\0".encode() + file.read_bytes() + b"\0")
    return digest.hexdigest()


def diagnosis_job(
    store: CaseStore,
    id_: str,
    script: Path,
    limit: float,
    hidden: Sequence[Path] = (),
    alone: bool = True,
) -> Job:
    """The diagnosis of a case, in the folder of all that it is given; a crash is an outcome.

    Args:
        store: Of the case.
        id_: Its name.
        script: `diagnose.py`.
        limit: Time limit [s].
        hidden: What it may not read, but for its own folders; nothing to run it openly.
        alone: Whether it has all cores; beside others it has one, and the same answer.
    """
    folder, seen = store.diagnosis(id_).resolve(), store.inputs(id_).resolve()
    command = (str(script.resolve()), "question.yaml", f"output={folder}")
    command = command if alone else (*command, "workers=1")
    if hidden:
        paths = (str(path.resolve()) for path in hidden)
        shown = (str(seen), str(folder))
        command = (confined.__file__, "--hidden", *paths, "--shown", *shown, "--", *command)
    return Job(id_, folder, command, cwd=seen, limit=limit, final=True)


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
        crashed = answer["verdict"] == baselines.CRASHED
        about = {"status": "crashed" if crashed else "answered"}
        about |= {"seconds": answer.get("seconds", 0.0)}
        found[method] = CaseAnswer.from_diagnosis(answer, about)
    return found


def asked(store: CaseStore, cases: Sequence[Concealing], kind: str = "development") -> list[Entry]:
    """Entries, sealed, of those of the cases that have an answer."""
    seals, found = store.digests(), []
    for case in cases:
        if store.diagnosed(case.id):
            second, file = again(case), store.diagnosis(case.id) / MADE
            retold = answers(store, second)[OURS] if store.diagnosed(second) else None
            told = answers(store, case.id)
            made = json.loads(file.read_text()) if file.exists() else {}
            entry = Entry(case.id, kind, seal=seals[case.id], answers=told, again=retold, made=made)
            found.append(entry)
    return found


def opened(config: SealedRun, drawn: Sequence[Concealing]) -> list[Entry]:
    """Entries of the cases that have an answer, by seed; the ledger's own are opened in it.

    Raises:
        FileNotFoundError: What an entered case was weighed by is not here.
    """
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
    new = asked(store, [case for case in drawn if case.id not in known], config.kind)
    known |= {entry.id: open_entry(store, entry) for entry in new}
    return [known[id_] for id_ in sorted(known)]


def all_opened(config: SealedRun) -> list[Entry]:
    """Entries of a ledger in which every case is opened, as it is published; none of another."""
    entries = [entry for entry in config.lines.entries() if entry.kind == config.kind]
    return [] if any(entry.opened is None for entry in entries) else entries


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
