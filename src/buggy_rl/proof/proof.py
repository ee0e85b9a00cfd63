"""A run of the proof: its options, its stages, and what they enter in the ledger."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

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
from buggy_rl.proof.cases.secret import refuse_public_secret
from buggy_rl.proof.cases.simulators import prepare, unprepared
from buggy_rl.proof.running import ProofStep, SealedRun, asked, diagnoses, parallel

STAGES = (
    *("publish", "prepare", "seal", "ask", "again"),
    *("weigh", "compare", "settle", "score", "page"),
)


@dataclass(frozen=True)
class ProofConfig(SealedRun):
    """Sealed cases, diagnosed and scored."""

    stages: list[str] = field(default_factory=lambda: list(STAGES))
    """Any of publish, prepare, seal, ask, again, weigh, compare, settle, score, page.

    What is done is not done again."""
    draw: DrawConfig = field(default_factory=DrawConfig)
    effects: list[str] = field(default_factory=list)
    """Effects that the diagnosis chooses from; empty for the whole library."""
    stretches: int = 0
    """Segments of 1 s that are diagnosed; 0 for the diagnosis's own choice."""
    rivals: int = 6
    """Other effects that are fitted to a case to see whether it is decidable."""
    images: str = ""
    """Folder for its pictures; empty for the page's own."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.stages) - set(STAGES))
        if unknown:
            raise ValueError(f"no stages {unknown}; available: {', '.join(STAGES)}")

    @property
    def kind(self) -> str:
        """Kind of its lines: the split."""
        return self.draw.split


def steps(
    config: ProofConfig, drawn: Sequence[Case], secret: str, scripts: Path
) -> Iterator[ProofStep]:
    """The stages before `settle`; each is planned when the one before it has run.

    Args:
        config: With the stages that are wanted.
        drawn: All cases of the run; those in the ledger are only published.
        secret: Of the run.
        scripts: Folder of `diagnose.py`, `fit_mujoco.py` and `train_models.py`.
    """
    store, stages = config.store, config.stages
    if {"publish", "seal"} & set(stages):
        if config.kind != "development":
            refuse_public_secret(store, drawn)
        publish(store, drawn, secret)
    cases = config.lines.left(drawn, store.digests())
    if "prepare" in stages:
        left = unprepared(cases, store.prepared)
        made = ((1, "") for case in left if prepare(case, store.prepared, scripts))
        yield ProofStep("preparing simulators", len(left), made)
    if "seal" in stages:
        options = (config.effects, secret, config.stretches)
        yield parallel(config, "sealing", seal, unsealed(store, cases), *options)
    if "ask" in stages:
        yield diagnoses(config, "diagnosing", [c.id for c in cases], scripts / "diagnose.py")
    if "again" in stages:
        left = [
            case
            for case in cases
            if not driven_again(store, case) and suggested_manoeuvres(store, case)
        ]
        yield parallel(config, "driving again", drive_again, left)
        ids = [again(case) for case in cases if store.inputs(again(case)).exists()]
        yield diagnoses(config, "diagnosing again", ids, scripts / "diagnose.py")
    if "weigh" in stages:
        from buggy_rl.proof.score.weighing import weigh

        left = [case for case in cases if store.diagnosed(case.id) and not store.weighed(case.id)]
        yield parallel(config, "fitting the truth", weigh, left, config.effects, config.rivals)
    if "compare" in stages:
        left = [case for case in cases if unanswered_methods(store, case)]
        yield parallel(config, "comparing", compare, left)


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
    ledger.enter(asked(store, left, config.kind))
    return len(left)


def complete(store: CaseStore, case: Case, compared: bool = True) -> bool:
    """Whether nothing of a case is left to run."""
    return (
        store.weighed(case.id)
        and (store.diagnosed(again(case)) or not suggested_manoeuvres(store, case))
        and not (compared and unanswered_methods(store, case))
    )
