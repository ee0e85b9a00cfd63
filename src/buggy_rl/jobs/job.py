"""A script with its options, the folder that it writes to, and whether it is done."""

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.files import write_json
from buggy_rl.jobs.process import OUTCOME, Command, read_outcome

RECORD = "job.json"


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
    """Files that the result depends on."""
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
            ValueError: It was begun with another command, or its inputs have changed since.
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
                f"{' '.join(self.recorded)!r}: use another output, or move the folder away"
            )
        if changed := [name for name, was in record["inputs"].items() if digest(name) != was]:
            raise ValueError(
                f"{self.folder} was begun before {', '.join(changed)} had changed: use another "
                "output, or move the folder away"
            )
        # Before there was an outcome.json, job.json said whether a job was done.
        return outcome.get("status") == "done" or record.get("done", False)

    def prepared(self, cores: int) -> Command:
        """What a worker needs to run it; the folder says from now on that it was begun.

        Args:
            cores: That it may keep busy.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / OUTCOME).unlink(missing_ok=True)
        if not self.final:
            inputs = {name: digest(name) for name in self.inputs}
            write_json(self.folder / RECORD, {"command": self.recorded, "inputs": inputs})
        cwd = Path.cwd() if self.cwd is None else self.cwd.resolve()
        folder = self.folder.resolve()
        return Command(folder, self.command, cwd, self.limit, self.checkpoint, cores)

    @property
    def recorded(self) -> list[str]:
        """The command, without the folder that the script is in."""
        return [Path(self.command[0]).name, *self.command[1:]]


def digest(file: str) -> str:
    """SHA-256 of a file's content; empty where there is no such file."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if Path(file).is_file() else ""
