"""A script with its options, the folder that it writes to, and whether it is done."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from buggy_rl.core.files import write_atomically, write_json
from buggy_rl.core.question import refuse_another
from buggy_rl.core.reads import files_read
from buggy_rl.jobs.process import OUTCOME, Command, read_outcome

RECORD = "job.json"
REMEDY = "use another output, or move the folder away"


@dataclass(frozen=True)
class Job:
    """A Python script with its options, and the folder that it writes to."""

    name: str
    folder: Path
    command: tuple[str, ...]
    """The script and its options; `-m` and a module in place of a script."""
    cwd: Path | None = None
    """Working directory; None for that of this process."""
    limit: float = math.inf
    """Time limit [s]."""
    final: bool = False
    """Whether any outcome counts, also a failure. Otherwise a failed job is run again, and one
    whose command or inputs have changed is refused."""
    inputs: tuple[str, ...] = ()
    """Files that the result depends on, with those that they name or import in turn."""
    question: Mapping[str, Any] = field(default_factory=dict)
    """What it depends on beside its command, by name (`buggy_rl.core.question`)."""
    texts: Mapping[Path, str] = field(default_factory=dict)
    """Files that it reads and that are written when it begins, not before it is known whether it
    is refused."""
    work: int = 1
    """Weight in the progress of several jobs."""
    checkpoint: str = ""
    """File in the folder; where it exists, the script is given `resume=true`."""
    share: Callable[[], float] = lambda: 0.0
    """Share of the work that is done, while the job runs."""

    @property
    def done(self) -> bool:
        """Whether the job needs no further run.

        Raises:
            ValueError: It was begun with another command or question, or its inputs have changed
                since; the message says what.
        """
        outcome = read_outcome(self.folder)
        if self.final:
            return bool(outcome)
        if not (self.folder / RECORD).exists():
            return False
        record = json.loads((self.folder / RECORD).read_text())
        if record["command"] != self.recorded:
            raise ValueError(
                f"{self.folder} was begun by {' '.join(record['command'])!r}, now wanted is "
                f"{' '.join(self.recorded)!r}: {REMEDY}"
            )
        if changed := [n for n, was in record["inputs"].items() if was != digest(n)]:
            raise ValueError(
                f"{self.folder} was begun before {', '.join(changed)} had changed: {REMEDY}"
            )
        if record.get("question") and self.question:  # an earlier version's record has none
            refuse_another(record["question"], dict(self.question), str(self.folder), REMEDY)
        return outcome.get("status") == "done"

    def prepared(self, cores: int) -> Command:
        """What a worker needs to run it; the folder says from now on that it was begun.

        Args:
            cores: That it may keep busy.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / OUTCOME).unlink(missing_ok=True)
        if not self.final:
            inputs = {name: digest(name) for name in self.inputs}
            record = {"command": self.recorded, "inputs": inputs}
            write_json(self.folder / RECORD, {**record, "question": dict(self.question)})
        for file, text in self.texts.items():
            write_atomically(file, text)
        cwd = Path.cwd() if self.cwd is None else self.cwd.resolve()
        folder = self.folder.resolve()
        return Command(folder, self.command, cwd, self.limit, self.checkpoint, cores)

    @property
    def recorded(self) -> list[str]:
        """The command, without the folder that the script is in."""
        return [Path(self.command[0]).name, *self.command[1:]]


def digest(name: str) -> str:
    """SHA-256 of a file's content, and of all that it names or imports; empty without a file.

    Args:
        name: A file, or `path/to/file.py:attribute`.
    """
    each = [_of_file(file) for file in files_read(name) or [Path(name)]]
    return each[0] if len(each) == 1 else hashlib.sha256("".join(sorted(each)).encode()).hexdigest()


def _of_file(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""
