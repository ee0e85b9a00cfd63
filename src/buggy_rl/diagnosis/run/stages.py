"""Stages of a diagnosis that are kept, so that an interrupted one goes on where it stopped."""

import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

from buggy_rl.core.files import is_own, load_signed, remove_folder, save_signed
from buggy_rl.core.question import Question, contents, difference, key, question, schema
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.recordings import Recording

FOLDER = "stages"  # in the folder of the answer
SCHEMA = 4  # of what is kept: raised when other code would not go on from it
ASKED = "asked"  # name of the question's own file
# Of the config: these change no answer, or are in the recordings that were read.
IGNORED = ("output", "threads", "workers", "recordings", "baseline", "columns")
CUT = re.compile(r"_[0-9a-f]{16}\.pt\.partial$")  # a stage that was being written

Result = TypeVar("Result")


class Stages:
    """Results of stages in a folder, each under what it was computed from.

    Args:
        folder: Where they are kept; None keeps nothing.
        config: The question.
        recordings: That the simulator should have predicted.
        baseline: On which it was right.
    """

    def __init__(
        self,
        folder: Path | None,
        config: DiagnosisConfig,
        recordings: Sequence[Recording] = (),
        baseline: Sequence[Recording] = (),
    ) -> None:
        self.folder = folder
        self._asked = {} if folder is None else diagnosis_question(config, recordings, baseline)

    def done(self, name: str, compute: Callable[[], Result]) -> Result:
        """The result of a stage: read if it was computed before, else computed and kept."""
        if self.folder is None:
            return compute()
        file = _file(self.folder, name, self._asked)
        if is_own(file):  # else a pickle of somebody else's
            return load_signed(file)
        result = compute()
        save_signed(_file(self.folder, ASKED, self._asked), self._asked)
        save_signed(file, result)
        return result


def diagnosis_question(
    config: DiagnosisConfig, recordings: Sequence[Recording], baseline: Sequence[Recording]
) -> Question:
    """The question, with the content of recordings and of all files of the simulator."""
    own = question(config, recordings, IGNORED, schema=schema(SCHEMA))
    return own | contents(baseline, "baseline recording")


def begun_otherwise(folder: Path, now: Question) -> str:
    """Why a diagnosis does not go on from what is kept in a folder; empty if it does."""
    kept = sorted(_own(folder, f"{ASKED}_*.pt"), key=lambda file: file.stat().st_mtime)
    if not kept:
        foreign = next(folder.glob(f"{ASKED}_*.pt"), None)
        return f"{foreign} was not written by this user on this machine" if foreign else ""
    if _file(folder, ASKED, now) in kept:
        return ""
    return difference(load_signed(kept[-1]), now)


def clear(folder: Path) -> None:
    """Takes away what was kept, and the folder if nothing else is in it."""
    for file in [*_own(folder, "*.pt"), *folder.glob("*.partial")]:
        if file.suffix == ".pt" or CUT.search(file.name):
            file.unlink()
    remove_folder(folder)


def _file(folder: Path, name: str, now: Question) -> Path:
    return folder / f"{name}_{key(now)}.pt"


def _own(folder: Path, pattern: str) -> Iterator[Path]:
    return (file for file in folder.glob(pattern) if is_own(file))
