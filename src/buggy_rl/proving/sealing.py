"""Cases on the disk: what may be seen, and what is sealed.

OUTPUT/cases/ID/      question.yaml, simulator.yaml, recordings/, baseline/
SEALED/ID.json        the answer, with a salt
SEALED/ID/            drives held out to measure by
OUTPUT/hashes.txt     SHA-256 of every sealed answer, made before any diagnosis
"""

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from buggy_rl.proving.case import Case
from buggy_rl.proving.measuring import measured
from buggy_rl.proving.motion import Motion, moved
from buggy_rl.proving.question import MODEL, prepared_name, question, simulator_content
from buggy_rl.recordings import save_recording

TOGETHER = 16  # cases that are driven in one batch


@dataclass(frozen=True)
class Vault:
    """Where the cases of a run lie."""

    output: Path
    sealed: Path

    def seen(self, id_: str) -> Path:
        """All that the tool is given."""
        return self.output / "cases" / id_

    def answer(self, id_: str) -> Path:
        """The sealed answer."""
        return self.sealed / f"{id_}.json"

    def held_out(self, id_: str) -> Path:
        """Sealed drives."""
        return self.sealed / id_

    def said(self, id_: str) -> Path:
        """What the tool answered."""
        return self.output / "answers" / id_

    def weighed(self, id_: str) -> Path:
        """What could be known of a case: tells the answer, so it lies with what is sealed."""
        return self.sealed / "weighed" / f"{id_}.json"

    @property
    def prepared(self) -> Path:
        """Simulators that were fitted or trained first."""
        return self.output / "prepared"

    @property
    def hashes(self) -> Path:
        """One line a case."""
        return self.output / "hashes.txt"

    def cases(self) -> list[Case]:
        """Opens all that is sealed: only for who has to count.

        Raises:
            ValueError: An answer is not the one whose hash was published.
        """
        published = {}
        for line in self.hashes.read_text().splitlines():
            digest, id_ = line.split()
            published[id_] = digest
        found = []
        for id_, digest in sorted(published.items()):
            text = self.answer(id_).read_bytes()
            if hashlib.sha256(text).hexdigest() != digest:
                raise ValueError(f"{self.answer(id_)} is not what was sealed: its hash differs")
            found.append(Case.from_dict(json.loads(text)["case"]))
        return found


def groups(cases: Sequence[Case]) -> list[list[Case]]:
    """Cases that can be driven in one batch, `TOGETHER` at most."""
    alike: dict[tuple, list[Case]] = {}
    for case in cases:
        alike.setdefault((case.plant, case.seconds), []).append(case)
    most = {"reference": TOGETHER}
    return [
        same[first : first + most.get(plant, 1)]
        for (plant, _), same in alike.items()
        for first in range(0, len(same), most.get(plant, 1))
    ]


def seal(
    vault: Vault,
    cases: Sequence[Case],
    effects: list[str],
    secret: str = "",
    stretches: int = 0,
) -> int:
    """Drives cases that share plant and length, and writes both halves of each.

    Args:
        vault: Where to.
        cases: Of one group.
        effects: That the tool may choose from; empty for the whole library.
        secret: Makes the salts; who knows it can guess an answer from its hash.
        stretches: Of the drives, that the tool looks at; 0 for its own choice.

    Returns:
        How many.
    """
    for case, motion in zip(cases, moved(cases), strict=True):
        _show(vault, case, motion, effects, stretches)
        _hold_out(vault, case, motion)
        salt = hashlib.sha256(f"{secret}:{case.seed}".encode()).hexdigest()[:32]
        text = json.dumps({"case": case.to_dict(), "salt": salt}, indent=1, sort_keys=True)
        # Last: a case whose answer is there is whole.
        partial = vault.answer(case.id).with_suffix(".partial")
        partial.write_text(text + "\n")
        partial.replace(vault.answer(case.id))
    return len(cases)


def publish(vault: Vault, cases: Sequence[Case]) -> None:
    """Writes the hashes of what was sealed; they stand before anything is diagnosed.

    Raises:
        ValueError: Others were published there before, or something else was sealed.
    """
    for case in cases:
        found = Case.from_dict(json.loads(vault.answer(case.id).read_text())["case"])
        if found != case:
            raise ValueError(
                f"{vault.answer(case.id)} was sealed by other settings: use another output"
            )
    lines = [
        f"{hashlib.sha256(vault.answer(case.id).read_bytes()).hexdigest()}  {case.id}"
        for case in sorted(cases, key=lambda case: case.seed)
    ]
    text = "\n".join(lines) + "\n"
    if vault.hashes.exists() and not text.startswith(vault.hashes.read_text()):
        raise ValueError(
            f"{vault.hashes} holds the hashes of other cases: sealed answers are not changed "
            "after they were published; use another output"
        )
    vault.hashes.write_text(text)


def _show(vault: Vault, case: Case, motion: Motion, effects: list[str], stretches: int) -> None:
    folder = vault.seen(case.id)
    shutil.rmtree(folder, ignore_errors=True)
    for name in ("recordings", "baseline") if case.baseline else ("recordings",):
        (folder / name).mkdir(parents=True)
    for place in range(case.drives):
        drive = measured(case, motion.changed[place], True, place)
        save_recording(drive, folder / "recordings" / f"{drive.name}.csv")
    if motion.clean is not None:
        for place in range(case.drives):
            # Numbered on from where the noise of the others ends.
            drive = measured(case, motion.clean[place], False, 100 + place)
            save_recording(drive, folder / "baseline" / f"drive_{place}.csv")
    (folder / "question.yaml").write_text(question(case, effects, stretches))
    content = simulator_content(case, vault.prepared)
    if content["engine"] == MODEL:
        shutil.copyfile(vault.prepared / f"{prepared_name(case)}.pt", folder / MODEL)
    else:
        (folder / "simulator.yaml").write_text(yaml.safe_dump(content, sort_keys=False))


def _hold_out(vault: Vault, case: Case, motion: Motion) -> None:
    folder = vault.held_out(case.id)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for place in range(case.drives, case.drives + case.held_out):
        drive = measured(case, motion.changed[place], True, place)
        save_recording(drive, folder / f"{drive.name}.csv")
