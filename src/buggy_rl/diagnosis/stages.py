"""Stages of a diagnosis that are kept, so that an interrupted one goes on where it stopped."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

import torch

from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.files import save_torch
from buggy_rl.recordings import Recording

FOLDER = "stages"  # in the folder of the answer
IRRELEVANT = ("output", "threads", "workers")  # of the question: they change no answer
SOURCE = Path(__file__).parents[1]  # of the package: other code, other answers

Result = TypeVar("Result")


class Stages:
    """Results of stages in a folder, each under what it was computed from.

    Args:
        folder: Where they are kept; None keeps nothing.
        config: The question.
        drives: All recordings, those of the baseline too.
    """

    def __init__(
        self, folder: Path | None, config: DiagnosisConfig, drives: Sequence[Recording]
    ) -> None:
        self.folder = folder
        self.key = "" if folder is None else _key(config, drives)

    def done(self, name: str, compute: Callable[[], Result]) -> Result:
        """The result of a stage: read if it was computed before, else computed and kept."""
        if self.folder is None:
            return compute()
        file = self.folder / f"{name}_{self.key}.pt"
        if file.exists():
            # Written by this very code, in a folder of the user's own.
            return torch.load(file, weights_only=False)
        result = compute()
        save_torch(file, result)
        return result


def _key(config: DiagnosisConfig, drives: Sequence[Recording]) -> str:
    """Of the question, the drives, the simulator's files and the package itself."""
    digest = hashlib.sha256()
    asked = {k: v for k, v in asdict(config).items() if k not in IRRELEVANT}
    digest.update(repr(asked).encode())
    for drive in drives:
        digest.update(drive.name.encode())
        for name, value in sorted(drive.data.items()):
            digest.update(name.encode() + value.contiguous().numpy().tobytes())
    simulator = Path(config.simulator.rpartition(":")[0] or config.simulator)
    files = [*sorted(SOURCE.rglob("*.py")), *([simulator] if simulator.is_file() else [])]
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
