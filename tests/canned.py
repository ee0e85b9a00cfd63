"""Diagnoses that several test modules read, computed once and kept on disk.

`run_diagnosis` itself keeps the stages of each one under its question: settings and the content of
recordings and simulator files. The folder is of one version of the source and of the libraries
that compute, so a result of other code is never read. Tests in other processes wait for whoever
computes a diagnosis first.
"""

import fcntl
import hashlib
import os
import platform
import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy
import scipy
import torch

import buggy_rl
from buggy_rl.core.kernels import CACHE, FOLDER
from buggy_rl.core.kernels import kernel_digest as kernel_digest
from buggy_rl.core.question import key
from buggy_rl.diagnosis.config import DiagnosisConfig
from buggy_rl.diagnosis.pipeline import Diagnosed, run_diagnosis
from buggy_rl.diagnosis.run.stages import diagnosis_question
from buggy_rl.recordings import Recording

SOURCE = Path(buggy_rl.__file__).parent
FORGOTTEN = 24 * 3600.0  # [s] after which results of other source are removed


def source_digest(source: Path = SOURCE) -> str:
    """16 hexadecimal digits of all that computes a diagnosis, except its question."""
    compiled = Path(os.environ.get(FOLDER, CACHE))
    parts = [torch.__version__, numpy.__version__, scipy.__version__, platform.python_version()]
    parts += sorted(file.name for file in compiled.glob(f"*-{kernel_digest()}.pt2"))
    found = hashlib.sha256("\0".join(parts).encode())
    for file in sorted(source.rglob("*")):
        if file.is_file() and file.suffix != ".pyc":
            found.update(f"\0{file.relative_to(source)}\0".encode() + file.read_bytes())
    return found.hexdigest()[:16]


def canned(folder: Path, config: DiagnosisConfig, recordings: Sequence[Recording]) -> Diagnosed:
    """The diagnosis of recordings, from its stages in `folder`/DIGEST where they are there.

    Args:
        folder: Of diagnoses of any source, shared by all test processes.
        config: The question.
        recordings: What the simulator should have predicted.
    """
    now = folder / source_digest()
    now.mkdir(parents=True, exist_ok=True)
    os.utime(now)
    with locked(folder / "lock"):
        for other in folder.iterdir():
            if other.is_dir() and time.time() - other.stat().st_mtime > FORGOTTEN:
                shutil.rmtree(other)
    with locked(now / f"{key(diagnosis_question(config, recordings, ()))}.lock"):
        return run_diagnosis(config, recordings, kept=now / "stages")


@contextmanager
def locked(file: Path) -> Iterator[None]:
    """Waits until no other process holds the file."""
    with file.open("a") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield
