"""Cases on the disk: what may be seen, and what is sealed.

OUTPUT/cases/ID/      question.yaml, simulator.yaml, recordings/, baseline/
SEALED/ID.json        the answer, with a salt
SEALED/ID/            drives held out to measure by
OUTPUT/hashes.txt     SHA-256 of every sealed answer, made before any drive
"""

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.exam import outcome_file
from buggy_rl.blind_test.measuring import measured
from buggy_rl.blind_test.motion import Motion, moved
from buggy_rl.blind_test.question import MODEL, prepared_name, question, simulator_content
from buggy_rl.recordings import save_recording

TOGETHER = 16  # cases that are driven in one batch


@dataclass(frozen=True)
class Vault:
    """Where the cases of a run lie."""

    output: Path
    sealed: Path
    published: Path | None = None
    """File of hashes that is shown to others; OUTPUT/hashes.txt by default."""

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

    def is_weighed(self, id_: str) -> bool:
        """Whether the answer that is there has been weighed; an earlier one's weighing is none."""
        file, said = self.weighed(id_), outcome_file(self.said(id_))
        if not (file.exists() and said.exists()):
            return False
        return file.stat().st_mtime_ns >= said.stat().st_mtime_ns

    @property
    def prepared(self) -> Path:
        """Simulators that were fitted or trained first."""
        return self.output / "prepared"

    @property
    def hashes(self) -> Path:
        """One line a case."""
        return self.published or self.output / "hashes.txt"

    def digests(self) -> dict[str, str]:
        """Case -> published hash of its answer."""
        if not self.hashes.exists():
            return {}
        lines = (line.split() for line in self.hashes.read_text().splitlines())
        return {id_: digest for digest, id_ in lines}

    def cases(self) -> list[Case]:
        """Opens all that is sealed here: only for who has to count.

        What was published to be asked later, or was asked elsewhere, is not among them.

        Raises:
            ValueError: An answer is not the one whose hash was published.
        """
        found = []
        for id_, digest in sorted(self.digests().items()):
            if not self.answer(id_).exists() and not self.said(id_).exists():
                continue
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
        # Last: a case whose answer is there is whole.
        partial = vault.answer(case.id).with_suffix(".partial")
        partial.write_text(_answer(case, secret))
        partial.replace(vault.answer(case.id))
    return len(cases)


def publish(vault: Vault, cases: Sequence[Case], secret: str = "") -> None:
    """Writes the hashes of answers; they stand before anything is diagnosed, and stay.

    Args:
        vault: Where the cases lie.
        cases: Sealed ones, or such as are to be sealed.
        secret: Makes the salts of those that are not sealed yet.

    Raises:
        ValueError: An answer with another hash was published there before, or sealed.
    """
    digests = vault.digests()
    for case in cases:
        text, file = _answer(case, secret), vault.answer(case.id)
        if file.exists():
            text = file.read_text()
            if Case.from_dict(json.loads(text)["case"]) != case:
                raise ValueError(f"{file} was sealed by other settings: use another output")
        digest = hashlib.sha256(text.encode()).hexdigest()
        if digests.setdefault(case.id, digest) != digest:
            raise ValueError(
                f"{vault.hashes} holds another hash of case {case.id}: sealed answers are not "
                "changed after they were published; use another output"
            )
    vault.hashes.parent.mkdir(parents=True, exist_ok=True)
    vault.hashes.write_text("".join(f"{digests[id_]}  {id_}\n" for id_ in sorted(digests)))


def _answer(case: Case, secret: str) -> str:
    salt = hashlib.sha256(f"{secret}:{case.seed}".encode()).hexdigest()[:32]
    return json.dumps({"case": case.to_dict(), "salt": salt}, indent=1, sort_keys=True) + "\n"


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
