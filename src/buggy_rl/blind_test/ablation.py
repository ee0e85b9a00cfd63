"""Ablation: development cases diagnosed again with one rule of the selection switched off."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from omegaconf import MISSING

from buggy_rl.blind_test.outcome import Outcome, outcome
from buggy_rl.blind_test.sealing import CaseStore
from buggy_rl.jobs import Job, read_outcome

NEVER = 1e9  # beyond any value that a rule is compared with
RULES: dict[str, float] = {  # field of `SelectionConfig` -> value with which its rule does nothing
    "min_nats": 0.0,
    "min_share": 0.0,
    "collinear_share": 0.0,
    "max_baseline_gain": NEVER,
    "residual_odds": NEVER,
    "even_ratio": 0.0,
    "varying_share": NEVER,
    "at_bound_factor": 1.0,
    "unknown_share": NEVER,
    "rivalled": NEVER,
    "undecided": 0.0,
    "finer_step_gain": NEVER,
}
AS_IT_IS = "as it is"


@dataclass(frozen=True)
class AblationConfig:
    """Rules that are switched off, one at a time, over the cases of a development run."""

    proof: str = MISSING
    """Output folder of a development run of scripts/prove.py, its cases driven."""
    output: str = MISSING
    """Folder of the answers, and of ablation.md."""
    rules: list[str] = field(default_factory=lambda: list(RULES))
    """Fields of the selection; all by default."""
    cases: list[str] = field(default_factory=list)
    """Ids; all by default."""
    limit: float = 3600.0
    """Time limit of a diagnosis [s]."""
    workers: int = 2
    """Diagnoses at a time."""

    def __post_init__(self) -> None:
        unknown = sorted(set(self.rules) - set(RULES))
        if unknown:
            raise ValueError(f"no rules {unknown}; available: {', '.join(RULES)}")

    @property
    def store(self) -> CaseStore:
        """Of the development run."""
        return CaseStore(Path(self.proof), Path(f"{self.proof}_sealed"))

    @property
    def ids(self) -> list[str]:
        """Of the cases."""
        return self.cases or sorted(f.name for f in (Path(self.proof) / "cases").iterdir())

    def folder(self, rule: str, id_: str) -> Path:
        """Of an answer."""
        return Path(self.output).resolve() / rule.replace(" ", "_") / id_


def ablations(config: AblationConfig, script: Path) -> list[Job]:
    """Diagnoses that have no outcome yet, that with all rules among them."""
    jobs = []
    for rule in (AS_IT_IS, *config.rules):
        change = () if rule == AS_IT_IS else (f"selection.{rule}={RULES[rule]}",)
        for id_ in config.ids:
            folder = config.folder(rule, id_)
            command = (str(script.resolve()), "question.yaml", *change, f"output={folder}")
            name, cwd = f"{rule} {id_}", config.store.inputs(id_).resolve()
            jobs.append(Job(name, folder, command, cwd, config.limit, final=True))
    return [job for job in jobs if not job.done]


def table(config: AblationConfig) -> str:
    """What each rule earns, as Markdown: counts over the cases that have an answer."""
    truths = {case.id: case for case in config.store.cases()}
    found = {
        rule: [_outcome(config, rule, truths[id_]) for id_ in config.ids]
        for rule in (AS_IT_IS, *config.rules)
    }
    lines = [
        "| without | first name right | exact set | confident and wrong | answers changed |",
        "|---|--:|--:|--:|--:|",
    ]
    for rule, outcomes in found.items():
        changed = sum(_said(a) != _said(b) for a, b in zip(outcomes, found[AS_IT_IS], strict=True))
        counts = [
            sum(o.right for o in outcomes),
            sum(o.names == frozenset(o.case.truth) for o in outcomes),
            sum(o.sure_and_wrong for o in outcomes),
            changed,
        ]
        lines.append(f"| {rule} | {' | '.join(map(str, counts))} |")
    return "\n".join([f"{len(config.ids)} cases.", "", *lines]) + "\n"


def _said(o: Outcome) -> Sequence[object]:
    return o.verdict, [(s.name, round(s.confidence, 2)) for s in o.said]


def _outcome(config: AblationConfig, rule: str, case) -> Outcome:
    folder = config.folder(rule, case.id)
    about = read_outcome(folder) or {"status": "missing", "seconds": 0.0}
    file = folder / "diagnosis.json"
    if about["status"] != "done" or not file.exists():
        return replace(Outcome(case), status=about["status"])
    return outcome(case, {**about, "status": "answered"}, json.loads(file.read_text()), {})
