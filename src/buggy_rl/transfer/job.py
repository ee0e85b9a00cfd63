"""A script that is run once, in a process of its own, and remembered in its folder."""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.blind_test.exam import write_json

RECORD = "job.json"  # how a job was begun, and whether it is done
LOG = "log.txt"  # all that its script said


@dataclass(frozen=True)
class Job:
    """A script with its options, and where it writes."""

    name: str
    folder: Path
    command: tuple[str, ...]
    """The script and its options."""
    inputs: tuple[str, ...] = ()
    """Files that it reads, and whose content its result hangs on."""
    work: int = 1
    """What it counts for beside others."""
    checkpoint: str = ""
    """File in the folder from which `resume=true` goes on; empty where a script does by itself."""
    share: Callable[[], float] = lambda: 0.0
    """How much of it is done, while it runs."""

    @property
    def done(self) -> bool:
        """Whether it was run to its end.

        Raises:
            ValueError: It was begun with another command, or from files that have changed since.
        """
        if not (self.folder / RECORD).exists():
            return False
        record = json.loads((self.folder / RECORD).read_text())
        if record["command"] != self._told():
            raise ValueError(
                f"{self.folder} was begun by {' '.join(record['command'])!r}, now wanted is "
                f"{' '.join(self._told())!r}: use another output, or move the folder away"
            )
        if changed := [name for name, was in record["inputs"].items() if digest(name) != was]:
            raise ValueError(
                f"{self.folder} was begun before {', '.join(changed)} had changed: use another "
                "output, or move the folder away"
            )
        return record["done"]

    def start(self) -> subprocess.Popen:
        """Runs the script, or goes on where it was stopped."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self._note(False, {name: digest(name) for name in self.inputs})
        resumed = bool(self.checkpoint) and (self.folder / self.checkpoint).exists()
        with open(self.folder / LOG, "a") as log:
            return subprocess.Popen(
                [sys.executable, *self.command, *(["resume=true"] if resumed else [])],
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"},
            )

    def finish(self) -> None:
        """Writes down that its script came to its end."""
        self._note(True, json.loads((self.folder / RECORD).read_text())["inputs"])

    def _note(self, done: bool, inputs: dict[str, str]) -> None:
        record = {"command": self._told(), "inputs": inputs, "done": done}
        write_json(self.folder / RECORD, record)

    def _told(self) -> list[str]:
        """The command, wherever the scripts lie."""
        return [Path(self.command[0]).name, *self.command[1:]]

    def last_words(self, length: int = 300) -> str:
        """The end of what the script said, in one line."""
        return " ".join((self.folder / LOG).read_text(errors="replace").split())[-length:]


def digest(file: str) -> str:
    """Of its content; empty where there is none."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if Path(file).is_file() else ""
