"""Real changes that are known: recordings before and after, measured, and diagnosed beside."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import torch

from buggy_rl.core import keys
from buggy_rl.core.files import write_json
from buggy_rl.jobs import Job
from buggy_rl.proof.cases.sealing import CaseStore
from buggy_rl.proof.ledger import OURS
from buggy_rl.proof.real.dataset import Dataset, DatasetConfig, refuse_copies
from buggy_rl.proof.real.measures import Measured, measured
from buggy_rl.proof.real.preparing import preparing, simulator_file
from buggy_rl.proof.real.sealing import QuestionConfig, write_question
from buggy_rl.proof.running import answers
from buggy_rl.proof.score.outcome import CaseAnswer
from buggy_rl.recordings import Recording

NAME = "known"  # of the dataset, in the names of files
FITTED = "fitted"  # of the recordings that its simulator is fitted to
PART = "@"  # NAME@FROM:TO is a part of a recording, in seconds


@dataclass(frozen=True)
class KnownChange:
    """Recordings before and after something changed, or with nothing changed in between."""

    change: str = ""
    """What changed, in words; empty where nothing did."""
    baseline: list[str] = field(default_factory=list)
    """Recordings before, as NAME or NAME@FROM:TO in seconds."""
    after: list[str] = field(default_factory=list)
    """Recordings since, likewise."""
    effects: list[str] = field(default_factory=list)
    """Effects of the library that say it rightly; none where nothing changed."""


@dataclass(frozen=True)
class KnownConfig:
    """Known changes of one car."""

    data: DatasetConfig | None = None
    """Recordings of the car; None for no known changes."""
    fit: list[str] = field(default_factory=list)
    """Names of the recordings that the simulator is fitted to."""
    engine: str = "single_track"
    """Simulator."""
    changes: dict[str, KnownChange] = field(default_factory=dict)
    """Name -> change; all are shown, whatever comes out."""


@dataclass(frozen=True)
class KnownResult:
    """What was measured of a change, and what was said of it."""

    name: str
    change: KnownChange
    measured: list[Measured]
    answer: CaseAnswer | None

    @property
    def right(self) -> bool | None:
        """Whether the first name above one half is right; of no change, that there is none."""
        if self.answer is None:
            return None
        sure = self.answer.given
        if not self.change.effects:
            return not sure
        return bool(sure) and sure[0] in self.change.effects


def id_of(name: str) -> str:
    """Name of the folders of a change."""
    return f"{NAME}_{name}"


def chosen_recordings(dataset: Dataset, names: Sequence[str]) -> list[Recording]:
    """Recordings by name, or parts of them.

    Raises:
        ValueError: There is no such recording, or nothing in the part.
    """
    known = {recording.name: recording for recording in dataset.recordings}
    found = []
    for asked in names:
        name, _, part = asked.partition(PART)
        if name not in known:
            raise ValueError(f"known: no recording {name!r}; available: {', '.join(sorted(known))}")
        found.append(_part(known[name], part) if part else known[name])
    return found


def _part(recording: Recording, part: str) -> Recording:
    begin, _, end = part.partition(":")
    time = recording.data[keys.TIME][:, 0] - recording.data[keys.TIME][0, 0]
    inside = (time >= float(begin or 0)) & (time < float(end or "inf"))
    if not bool(inside.any()):
        raise ValueError(f"known: {recording.name} has {recording.duration:g} s: nothing in {part}")
    data: Any = recording.data[torch.nonzero(inside).squeeze(-1)].clone()
    return replace(recording, name=f"{recording.name}_{begin}", data=data)


def known_job(
    store: CaseStore, dataset: Dataset, config: KnownConfig, scripts: Path
) -> dict[Path, Job]:
    """The job that fits the simulator of all changes, by its file; none where that is there."""
    file = _simulator(store, dataset, config)
    if file.exists():
        return {}
    fitted = chosen_recordings(dataset, config.fit)
    job = preparing(dataset, FITTED, config.engine, store.prepared, scripts, fitted)
    return {file: job}


def _simulator(store: CaseStore, dataset: Dataset, config: KnownConfig) -> Path:
    return simulator_file(store.prepared, dataset.name, FITTED, config.engine)


def write_known(
    store: CaseStore, dataset: Dataset, config: KnownConfig, question: QuestionConfig
) -> list[str]:
    """Measures every change and writes what its diagnosis is given; the names of their folders.

    Raises:
        ValueError: A recording is not there, or lies on both sides of a change.
    """
    for name, change in config.changes.items():
        baseline = chosen_recordings(dataset, change.baseline)
        after = chosen_recordings(dataset, change.after)
        if not (store.inputs(id_of(name)) / "question.yaml").exists():
            refuse_copies([*baseline, *after])
            found = [asdict(m) for m in measured(baseline, after)]
            write_json(_measures(store, name), found)
            simulator = _simulator(store, dataset, config)
            folder = store.inputs(id_of(name))
            write_question(folder, after, baseline, simulator, dataset.config, question)
    return [id_of(name) for name in config.changes]


def _measures(store: CaseStore, name: str) -> Path:
    return store.output / NAME / f"{name}.json"


def known_results(store: CaseStore, changes: Mapping[str, KnownChange]) -> list[KnownResult]:
    """Results of all changes that were measured."""
    found = []
    for name, change in changes.items():
        if _measures(store, name).exists():
            said = [Measured(**m) for m in json.loads(_measures(store, name).read_text())]
            id_ = id_of(name)
            answer = answers(store, id_)[OURS] if store.diagnosed(id_) else None
            found.append(KnownResult(name, change, said, answer))
    return found
