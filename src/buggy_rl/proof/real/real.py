"""A run of the proof on real recordings: its options, its stages, and what they enter."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from buggy_rl.jobs import Job
from buggy_rl.proof.cases.sealing import CaseStore, publish
from buggy_rl.proof.cases.secret import refuse_public_secret
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.real.dataset import Dataset, DatasetConfig, load_dataset
from buggy_rl.proof.real.draw import RealDrawConfig
from buggy_rl.proof.real.known import NAME, KnownConfig, known_job, write_known
from buggy_rl.proof.real.preparing import prepared, preparing, simulator_file
from buggy_rl.proof.real.sealing import QuestionConfig, seal_edited, unsealed_groups
from buggy_rl.proof.running import ProofStep, SealedRun, asked, diagnoses, parallel

STAGES = ("prepare", "seal", "ask", "weigh", "settle", "score", "known", "page")


@dataclass(frozen=True)
class RealProofConfig(SealedRun):
    """Edited recordings of real cars, diagnosed and scored; known changes set beside."""

    stages: list[str] = field(default_factory=lambda: list(STAGES))
    """Any of prepare, seal, ask, weigh, settle, score, known, page; done is done."""
    datasets: dict[str, DatasetConfig] = field(default_factory=dict)
    """Name -> recordings of one car."""
    draw: RealDrawConfig = field(default_factory=RealDrawConfig)
    question: QuestionConfig = field(default_factory=QuestionConfig)
    rivals: int = 6
    """Other effects that are fitted to a case to see how strongly the true one shows."""
    known: KnownConfig = field(default_factory=KnownConfig)

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.stages) - set(STAGES)):
            raise ValueError(f"no stages {unknown}; available: {', '.join(STAGES)}")
        if not self.datasets:
            raise ValueError("datasets is empty: give recordings, as configs/proof_real.yaml does")

    @property
    def store(self) -> CaseStore:
        """Store of its cases."""
        return replace(super().store, cases=RealCase)

    @property
    def kind(self) -> str:
        """Kind of its lines."""
        return "real"

    @property
    def hidden(self) -> list[Path]:
        """What no diagnosis may read: the recordings before they were edited too."""
        known = [self.known.data] if self.known.data is not None else []
        names = [name for data in (*self.datasets.values(), *known) for name in data.recordings]
        return [*super().hidden, *map(Path, names)]


def steps(
    config: RealProofConfig,
    datasets: Mapping[str, Dataset],
    drawn: Sequence[RealCase],
    secret: str,
    scripts: Path,
) -> Iterator[ProofStep]:
    """The stages before `settle`; each is planned when the one before it has run.

    Args:
        config: With the stages that are wanted.
        datasets: By name.
        drawn: All cases of the run; those in the ledger are only published.
        secret: Of the run.
        scripts: Folder of `diagnose.py`, `fit_mujoco.py` and `train_models.py`.
    """
    store, stages = config.store, config.stages
    if "seal" in stages:
        refuse_public_secret(store, drawn)
        publish(store, drawn, secret)
    cases = config.lines.left(drawn, store.digests())
    if "prepare" in stages:
        jobs = unprepared_jobs(store, datasets, cases, scripts)
        yield ProofStep("preparing simulators", len(jobs), prepared(jobs, config.workers, config))
    if "seal" in stages:
        left = unsealed_groups(store, cases)
        options = (dict(config.datasets), secret, config.question)
        yield parallel(config, "sealing", seal_edited, left, *options)
    if "ask" in stages:
        yield diagnoses(config, "diagnosing", [c.id for c in cases], scripts / "diagnose.py")
    if "weigh" in stages:
        from buggy_rl.proof.real.strength import weigh_edited

        left = [case for case in cases if store.diagnosed(case.id) and not store.weighed(case.id)]
        yield parallel(config, "fitting the truth", weigh_edited, left, config.rivals)


def unprepared_jobs(
    store: CaseStore, datasets: Mapping[str, Dataset], cases: Sequence[RealCase], scripts: Path
) -> dict[Path, Job]:
    """File of each simulator that is still to be prepared -> the job that makes it."""
    found: dict[Path, Job] = {}
    for case in cases:
        file = simulator_file(store.prepared, case.dataset, case.other, case.engine)
        if file not in found and not file.exists():
            dataset = datasets[case.dataset]
            found[file] = preparing(dataset, case.other, case.engine, store.prepared, scripts)
    return found


def settle(config: RealProofConfig, drawn: Sequence[RealCase]) -> int:
    """Enters all cases that are diagnosed and weighed; how many."""
    store, ledger = config.store, config.lines
    left = [case for case in ledger.left(drawn) if store.weighed(case.id)]
    ledger.enter(asked(store, left, config.kind))
    return len(left)


def known_steps(config: RealProofConfig, scripts: Path) -> Iterator[ProofStep]:
    """Known changes: their simulator, then their diagnoses.

    Raises:
        ValueError: No recordings of known changes are given.
    """
    if config.known.data is None:
        raise ValueError("known.data is not given: no recordings of known changes")
    dataset = load_dataset(NAME, config.known.data)
    jobs = known_job(config.store, dataset, config.known, scripts)
    made = prepared(jobs, config.workers, config)
    yield ProofStep("preparing a simulator", len(jobs), made)
    ids = write_known(config.store, dataset, config.known, config.question)
    yield diagnoses(config, "diagnosing known changes", ids, scripts / "diagnose.py")
