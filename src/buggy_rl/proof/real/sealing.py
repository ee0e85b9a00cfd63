"""Edited recordings on the disk, in the layout of `proof.cases.sealing`.

OUTPUT/cases/ID/  question.yaml, simulator, recordings/, baseline/
SEALED/ID.json    what is concealed, with a salt
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from buggy_rl.core.files import clear_folder, write_atomically
from buggy_rl.proof.cases.sealing import INPUTS, CaseStore, sealed_text
from buggy_rl.proof.cases.simulators import CAR, COLUMNS
from buggy_rl.proof.real.case import RealCase
from buggy_rl.proof.real.dataset import Dataset, DatasetConfig, load_dataset
from buggy_rl.proof.real.draw import edited_half
from buggy_rl.proof.real.preparing import give_simulator, save_recordings, simulator_file
from buggy_rl.recordings import Recording, load_recordings

TOGETHER = 20  # cases of a job that reads their dataset once
LOST = 0.02  # share of the rows that a reader may cut


@dataclass(frozen=True)
class QuestionConfig:
    """What every diagnosis is asked beside simulator and recordings."""

    stretches: int = 0
    """Segments of 1 s; 0 for the diagnosis's own choice."""
    minutes: float = 10.0
    """Time that a diagnosis may take [min]; 0 for as long as it needs."""
    effects: list[str] = field(default_factory=list)
    """Effects to choose from; empty for the whole library."""

    @property
    def plain(self) -> dict[str, Any]:
        """Options of `scripts/diagnose.py`, without those at their default."""
        given = {"stretches": self.stretches, "effects": list(self.effects)}
        return {"minutes": self.minutes, **{name: v for name, v in given.items() if v}}


def unsealed_groups(store: CaseStore, cases: Sequence[RealCase]) -> list[list[RealCase]]:
    """Cases that are still to be sealed, those of one dataset together."""
    left: dict[str, list[RealCase]] = {}
    for case in cases:
        if not store.truth(case.id).exists():
            left.setdefault(case.dataset, []).append(case)
    return [
        same[first : first + TOGETHER]
        for same in left.values()
        for first in range(0, len(same), TOGETHER)
    ]


def seal_edited(
    store: CaseStore,
    cases: Sequence[RealCase],
    datasets: Mapping[str, DatasetConfig],
    secret: str,
    question: QuestionConfig,
) -> int:
    """Edits the recordings of cases of one dataset and writes what may be seen; how many.

    Raises:
        ValueError: A reader refuses an edited recording, or cuts more than `LOST` of it.
    """
    dataset = load_dataset(cases[0].dataset, datasets[cases[0].dataset])
    for case in cases:
        write_case(store, case, dataset, question)
        # Last: a case whose sealed file is there is complete.
        write_atomically(store.truth(case.id), sealed_text(case, secret))
    return len(cases)


def write_case(
    store: CaseStore, case: RealCase, dataset: Dataset, question: QuestionConfig
) -> None:
    """Writes what may be seen of a case."""
    simulator = simulator_file(store.prepared, case.dataset, case.other, case.engine)
    changed = edited_half(dataset, case.half, case.concealed)
    baseline = dataset.half(case.other) if case.baseline else []
    write_question(store.inputs(case.id), changed, baseline, simulator, dataset.config, question)


def write_question(
    folder: Path,
    recordings: Sequence[Recording],
    baseline: Sequence[Recording],
    simulator: Path,
    config: DatasetConfig,
    question: QuestionConfig,
) -> None:
    """Writes the folder that a diagnosis is given.

    Args:
        folder: Its own files in it are written anew.
        recordings: What the simulator should have predicted.
        baseline: What it predicted rightly; empty where none is given.
        simulator: Its file.
        config: The car.
        question: What else is asked.

    Raises:
        ValueError: A reader refuses a recording, or cuts more than `LOST` of it.
    """
    clear_folder(folder, INPUTS)
    content: dict[str, Any] = {"recordings": ["recordings"]}
    content |= {"car": config.car, "columns": COLUMNS, **question.plain}
    if Path(config.car).is_file():  # else a name in configs/cars
        content["car"] = CAR
        write_atomically(folder / CAR, Path(config.car).read_bytes())
    save_recordings(_tracked(recordings), folder / "recordings", "drive")
    if baseline:
        content["baseline"] = ["baseline"]
        save_recordings(_tracked(baseline), folder / "baseline", "drive")
    for part, given in (("recordings", recordings), ("baseline", baseline)):
        if given:
            (folder / part / COLUMNS).replace(folder / COLUMNS)
            _refuse_unread(folder, part, config.car, sum(map(len, given)))
    content["simulator"] = give_simulator(simulator, folder)
    write_atomically(folder / "question.yaml", yaml.safe_dump(content, sort_keys=False))


def _tracked(recordings: Sequence[Recording]) -> list[Recording]:
    """Recordings without sensors beside the tracker: an edit of the tracker would show in them."""
    kept = ("t", "pose", "velocity", "action", "segment")
    return [Recording(r.name, r.data.select(*kept), r.dt, command=r.command) for r in recordings]


def _refuse_unread(folder: Path, part: str, car: str, rows: int) -> None:
    found, refusals = load_recordings([str(folder / part)], folder / COLUMNS, car=car)
    if refusals:
        raise ValueError(f"an edited recording is refused: {refusals[0]}")
    read = sum(len(recording) for recording in found)
    if read < (1 - LOST) * rows:
        notes = "; ".join(note for recording in found for note in recording.notes)
        raise ValueError(f"{folder / part}: {rows - read} of {rows} rows are cut: {notes}")
