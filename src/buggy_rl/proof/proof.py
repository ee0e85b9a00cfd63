"""A run of the proof: its options, and its stages up to the answers of other methods."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from omegaconf import MISSING

from buggy_rl.jobs import Job, results, run_jobs
from buggy_rl.jobs.launching import Launching
from buggy_rl.proof.baselines import compare, unanswered_methods
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import PAIRINGS, DrawConfig, draw_all
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
from buggy_rl.proof.plants import abilities
from buggy_rl.proof.score.outcome import Ledger

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
    def ledger_file(self) -> Path:
        """File of scored cases."""
        return Path(self.ledger or self.store.output / "ledger.jsonl")

    @property
    def counter(self) -> Path:
        """File that counts how often sealed cases were scored."""
        return Path(self.opened or self.store.output / "opened.json")


def cases_of(config: ProofConfig) -> list[Case]:
    """What is drawn by a config."""
    plants = {PAIRINGS[name].plant for name in config.draw.pairings}
    return draw_all(config.draw, {plant: abilities(plant) for plant in plants})


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
    cases = Ledger(config.ledger_file).open(drawn)
    if "prepare" in stages:
        left = unprepared(cases, store.prepared)
        made = ((1, "") for case in left if prepare(case, store.prepared, scripts))
        yield ProofStep("preparing simulators", len(left), made)
    if "seal" in stages:
        publish(store, drawn, config.secret)
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
