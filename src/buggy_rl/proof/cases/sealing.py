"""Cases on the disk: what the diagnosis is given, and what is sealed.

OUTPUT/cases/ID/      question.yaml, simulator.yaml, recordings/, baseline/
OUTPUT/answers/ID/    what the diagnosis wrote
SEALED/ID.json        what is concealed, with a salt (the secret is in `secret`)
SEALED/ID/            held-out drives
SEALED/weighed/       the oracle's fits
OUTPUT/hashes.txt     SHA-256 of every sealed answer, made before any drive
"""

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import yaml

from buggy_rl.core.files import clear_folder, write_atomically
from buggy_rl.core.longitudinal import ONE_WAY
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.diagnosis.answer.manoeuvres import MANOEUVRES, TIMES, Manoeuvre
from buggy_rl.jobs import OUTCOME
from buggy_rl.policies.controllers.replay import ReplayDriver
from buggy_rl.proof.cases.case import Case, Concealing, written
from buggy_rl.proof.cases.drives import (
    TrueMotion,
    acting,
    drive_cases,
    measured_car,
    plant_of,
    plant_parameters,
    true_drive,
)
from buggy_rl.proof.cases.simulators import (
    BASELINE_NOISE,
    CAR,
    COLUMNS,
    MODEL,
    diagnosis_options,
    prepared_name,
    save_drives,
    simulator_content,
)
from buggy_rl.recordings import save_command

# Files of a case, in the folders of what the diagnosis is given and of what judges it.
INPUTS = (
    *("question.yaml", "simulator.yaml", MODEL, CAR, COLUMNS),
    *("recordings/drive_*.csv", "recordings/manoeuvre_*.csv", "baseline/drive_*.csv"),
)
HELD_OUT = ("drive_*.csv",)
TOGETHER = 16  # cases that are driven in one batch
SIZE = 4096  # [bytes] of a sealed text, filled up with spaces: its size tells nothing


@dataclass(frozen=True)
class CaseStore:
    """Store of the cases of a run."""

    output: Path
    sealed: Path
    published: Path | None = None
    """File of hashes that is shown to others; OUTPUT/hashes.txt by default."""
    cases: type = Case
    """Class of its cases."""

    def told(self, error: Exception) -> str:
        """An error as the ledger has it, which is published: without these folders' own places."""
        said = f"{type(error).__name__}: {error}"
        for folder in (self.output, self.sealed):
            said = said.replace(f"{folder}/", "")
        return said

    def inputs(self, id_: str) -> Path:
        """Folder of all that the diagnosis is given."""
        return self.output / "cases" / id_

    def diagnosis(self, id_: str) -> Path:
        """Folder that the diagnosis writes to."""
        return self.output / "answers" / id_

    def truth(self, id_: str) -> Path:
        """File of what is concealed."""
        return self.sealed / f"{id_}.json"

    def held_out(self, id_: str) -> Path:
        """Folder of held-out drives."""
        return self.sealed / id_

    def oracle(self, id_: str) -> Path:
        """File of the oracle's fits: they tell what is concealed, so it is sealed."""
        return self.sealed / "weighed" / f"{id_}.json"

    def diagnosed(self, id_: str) -> bool:
        """Whether the diagnosis of a case has an outcome."""
        return (self.diagnosis(id_) / OUTCOME).exists()

    def weighed(self, id_: str) -> bool:
        """Whether the oracle's fits are there and not older than the diagnosis."""
        oracle = self.oracle(id_)
        if not (oracle.exists() and self.diagnosed(id_)):
            return False
        return oracle.stat().st_mtime_ns >= (self.diagnosis(id_) / OUTCOME).stat().st_mtime_ns

    @property
    def prepared(self) -> Path:
        """Folder of simulators that were fitted or trained first."""
        return self.output / "prepared"

    @property
    def hashes(self) -> Path:
        """File with one line a case."""
        return self.published or self.output / "hashes.txt"

    def digests(self) -> dict[str, str]:
        """Case -> published hash of what is concealed in it."""
        if not self.hashes.exists():
            return {}
        lines = (line.split() for line in self.hashes.read_text().splitlines())
        return {id_: digest for digest, id_ in lines}

    def sealed_case(self, id_: str, digest: str = "") -> Any:
        """Opens a case: only for scoring.

        Args:
            id_: Its name.
            digest: Hash of what was sealed; empty for the published one.

        Raises:
            FileNotFoundError: It was not sealed here.
            ValueError: The sealed file is another one.
        """
        file = self.truth(id_)
        if not file.exists():
            raise FileNotFoundError(f"{file} is missing: score case {id_} where it was sealed")
        text = file.read_bytes()
        if hashlib.sha256(text).hexdigest() != (digest or self.digests()[id_]):
            raise ValueError(f"{file} is not what was sealed: its hash differs")
        return self.read(text)

    def read(self, text: str | bytes) -> Any:
        """The case that a sealed text holds."""
        return self.cases(**json.loads(text)["case"])


def unsealed(store: CaseStore, cases: Sequence[Case]) -> list[list[Case]]:
    """Groups of cases that are still to be sealed, whole ones: the batch of a case stays."""
    return [
        group for group in groups(cases) if not all(store.truth(case.id).exists() for case in group)
    ]


def groups(cases: Sequence[Case]) -> list[list[Case]]:
    """Cases that can be driven in one batch, `TOGETHER` at most."""
    alike: dict[tuple, list[Case]] = {}
    for case in cases:
        alike.setdefault(
            (case.plant, case.command, case.seconds, case.rate, case.scale), []
        ).append(case)
    most = {"reference": TOGETHER}
    return [
        same[first : first + most.get(plant, 1)]
        for (plant, *_), same in alike.items()
        for first in range(0, len(same), most.get(plant, 1))
    ]


def seal(
    store: CaseStore, cases: Sequence[Case], effects: list[str], secret: str = "", segments: int = 0
) -> int:
    """Drives cases that share plant and length, and writes both halves of each; how many.

    Args:
        store: Where to.
        cases: Of one group.
        effects: That the diagnosis may choose from; empty for the whole library.
        secret: Makes the salts; who knows it can guess what is concealed from its hash.
        segments: Of the drives, that are diagnosed; 0 for the diagnosis's own choice.
    """
    for case, motion in zip(cases, drive_cases(cases), strict=True):
        _write_inputs(store, case, motion)
        text = diagnosis_options(case, effects, segments)
        (store.inputs(case.id) / "question.yaml").write_text(text)
        held_out = store.held_out(case.id)
        clear_folder(held_out, HELD_OUT)
        numbers = {f"drive_{n}": n for n in range(case.drives, case.drives + case.held_out)}
        save_drives(case, motion.changed[case.drives :], held_out, numbers)
        # Last: a case whose sealed file is there is complete.
        write_atomically(store.truth(case.id), sealed_text(case, secret))
    return len(cases)


def publish(store: CaseStore, cases: Sequence[Concealing], secret: str = "") -> None:
    """Writes the hashes of answers; they stand before anything is diagnosed, and stay.

    `secret` makes the salts of those that are not sealed yet.

    Raises:
        ValueError: An answer with another hash was published there before, or sealed.
    """
    digests = store.digests()
    for case in cases:
        text, file = sealed_text(case, secret), store.truth(case.id)
        if file.exists():
            text = file.read_text()
            if store.read(text) != case:
                raise ValueError(f"{file} was sealed by other settings: use another output")
        digest = hashlib.sha256(text.encode()).hexdigest()
        if digests.setdefault(case.id, digest) != digest:
            raise ValueError(
                f"{store.hashes} holds another hash of case {case.id}: sealed answers are not "
                "changed after they were published; use another output"
            )
    lines = (f"{digests[id_]}  {id_}\n" for id_ in sorted(digests))
    write_atomically(store.hashes, "".join(lines))


def sealed_text(case: Concealing, secret: str) -> str:
    """What is sealed of a case: all of it, with a salt made from a secret."""
    salt = hashlib.sha256(f"{secret}:{case.seed}".encode()).hexdigest()[:32]
    text = json.dumps({"case": vars(case), "salt": salt}, indent=1, sort_keys=True)
    return text.ljust(SIZE - 1) + "\n"


def _write_inputs(store: CaseStore, case: Case, motion: TrueMotion) -> None:
    folder = store.inputs(case.id)
    clear_folder(folder, INPUTS)
    numbers = {f"drive_{n}": n for n in range(case.drives)}
    save_drives(case, motion.changed[: case.drives], folder / "recordings", numbers)
    if motion.clean is not None:
        numbers = {name: BASELINE_NOISE + number for name, number in numbers.items()}
        save_drives(case, motion.clean, folder / "baseline", numbers, changed=False)
    if case.longitudinal != ONE_WAY:
        save_command(case.longitudinal, folder / COLUMNS)
    if (car := measured_car(case)) is not None:
        (folder / CAR).write_text(yaml.safe_dump(written(car), sort_keys=False))
    content = simulator_content(case, store.prepared)
    if content["engine"] == MODEL:
        shutil.copyfile(store.prepared / f"{prepared_name(case)}.pt", folder / MODEL)
    else:
        (folder / "simulator.yaml").write_text(yaml.safe_dump(content, sort_keys=False))


NOISE = 200  # number of the first manoeuvre drive, behind those of all other drives


def suggested_manoeuvres(store: CaseStore, case: Case) -> list[Manoeuvre]:
    """The manoeuvres that the diagnosis suggested where its verdict is `cannot_tell`."""
    file = store.diagnosis(case.id) / "diagnosis.json"
    if not file.exists():
        return []
    answer = json.loads(file.read_text())
    if answer["verdict"] != "cannot_tell":
        return []
    lines = answer.get("excitation", {}).get("suggest", [])
    return [m for m in MANOEUVRES if any(line.startswith(m.words) for line in lines)]


def again(case: Concealing) -> str:
    """Name of the case's second run."""
    return f"{case.id}_again"


def driven_again(store: CaseStore, case: Case) -> bool:
    """Whether the manoeuvres of a case have been driven."""
    return (store.inputs(again(case)) / "question.yaml").exists()


def drive_again(store: CaseStore, case: Case) -> int:
    """Drives the suggested manoeuvres in the concealed car and adds them to the recordings.

    Returns 1, the number of cases.
    """
    inputs, folder = store.inputs(case.id), store.inputs(again(case))
    clear_folder(folder, INPUTS)
    shutil.copytree(inputs, folder, ignore=shutil.ignore_patterns("question.yaml"))
    pose = torch.zeros(TIMES, 3)  # in the middle, headings spread around the compass
    pose[:, 2] = torch.arange(TIMES) * 2 * torch.pi / TIMES - torch.pi
    for place, manoeuvre in enumerate(suggested_manoeuvres(store, case)):
        actions = manoeuvre.actions(case.every * CONTROL_PERIOD)
        plant = plant_of(case, TIMES, case.faults, plant_parameters(case))
        act = acting([case.disturbances], [TIMES])
        rows = case.every * len(actions)
        true = true_drive(plant, ReplayDriver(actions), pose, rows, act, case.every)
        numbers = range(place * TIMES, (place + 1) * TIMES)
        named = {f"manoeuvre_{number}": NOISE + number for number in numbers}
        save_drives(case, true, folder / "recordings", named)
    # Last: a folder with a question is complete.
    shutil.copyfile(inputs / "question.yaml", folder / "question.yaml")
    return 1
