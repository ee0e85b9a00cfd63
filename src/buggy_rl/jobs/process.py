"""The process of a job, on whichever machine, and the outcome that it leaves on the disk."""

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from buggy_rl.core.files import write_json
from buggy_rl.jobs import leash

CORES = "BUGGY_RL_CORES"
"""Environment variable: the share of a job."""


def cores() -> int:
    """Cores that this process may keep busy: its share where it is a job, else its affinity.

    Raises:
        ValueError: The environment variable is no number above 0.
    """
    given = os.environ.get(CORES, "")
    if given and not (given.isdecimal() and int(given)):
        raise ValueError(f"{CORES}={given}: must be a number of cores above 0, or not set")
    return int(given) if given else len(os.sched_getaffinity(0))


OUTCOME = "outcome.json"
LOG = "log.txt"
LOCK = "lock"
STOP = "stop"
"""A file in a job's folder, whose presence makes a worker on any machine end the job."""
POLL = 0.2  # [s] between two looks at a running process
GRACE = 10.0  # [s] from SIGTERM to SIGKILL
TAIL = 2000  # [characters] of the log that the outcome keeps
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
DONE, FAILED, TIMED_OUT, LOST, STOPPED = "done", "failed", "timed out", "lost", "stopped"
FROM_OUTSIDE = {-signal.SIGKILL, -signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP}
"""Exit codes of a process that was ended by another one; it says nothing about the job."""


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    status: str
    """done, failed or timed out; of a job without an outcome: lost or stopped."""
    seconds: float
    """Run time [s]."""
    last_words: str
    """End of the log."""


@dataclass(frozen=True)
class Command:
    """What a worker needs to run a job; can be pickled."""

    folder: Path
    arguments: tuple[str, ...]
    cwd: Path
    limit: float
    """[s]"""
    checkpoint: str
    """File in the folder; where it exists, `resume=true` is added to the arguments."""
    cores: int


class Process:
    """A job's script, in a session of its own, that ends when this process does.

    Started from its checkpoint where there is one. Whoever holds this object writes the outcome.
    """

    def __init__(self, command: Command) -> None:
        self._command, self._begun = command, time.monotonic()
        resumed = bool(command.checkpoint) and (command.folder / command.checkpoint).exists()
        more = ["resume=true"] if resumed else []
        own = [sys.executable, leash.__file__, str(command.folder / LOCK)]
        with open(command.folder / LOG, "a") as log:
            self._process = subprocess.Popen(
                [*own, *command.arguments, *more],
                cwd=command.cwd,
                stdin=subprocess.PIPE,  # nothing is written: its end tells that we have ended
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | ONE_THREAD | {CORES: str(command.cores)},
            )

    def poll(self) -> str | None:
        """None while it runs; then its status, with the outcome written unless it was lost."""
        seconds, code = time.monotonic() - self._begun, self._process.poll()
        if code is None and seconds < self._command.limit:
            return None
        status = _status(code)
        self.end()
        if status != LOST:
            outcome = Outcome(status, round(seconds, 1), last_words(self._command.folder))
            write_json(self._command.folder / OUTCOME, asdict(outcome))
        return status

    def end(self) -> None:
        """Ends it, with all that it has started."""
        assert self._process.stdin is not None
        if not self._process.stdin.closed:  # its number may be another process's by now
            end(self._process)
            self._process.stdin.close()


def attend(command: Command) -> str:
    """Runs a job in this worker until it ends or is to be stopped; its status."""
    process = Process(command)
    try:
        while (status := process.poll()) is None:
            if (command.folder / STOP).exists():
                return STOPPED
            time.sleep(POLL)
        return status
    finally:
        process.end()


def wait_until_free(folder: Path, patience: float = 2 * GRACE) -> None:
    """Waits until no process works on a job any more, which `STOP` has told it.

    Raises:
        ValueError: One still does after `patience` seconds.
    """
    until = time.monotonic() + patience
    with open(folder / LOCK, "a") as lock:
        while True:
            try:
                return fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > until:
                    raise ValueError(f"{folder}: its lost worker still works on it") from None
                time.sleep(POLL)


def end(process: subprocess.Popen) -> None:
    """Ends a process that leads a session, with all that it has started."""
    try:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(GRACE)
    except (subprocess.TimeoutExpired, ProcessLookupError):
        pass  # SIGKILL follows in any case
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()


def read_outcome(folder: Path) -> dict[str, Any]:
    """The outcome in a job's folder; empty where there is none."""
    file = folder / OUTCOME
    return json.loads(file.read_text()) if file.exists() else {}


def last_words(folder: Path) -> str:
    """End of a job's log; empty where there is none."""
    file = folder / LOG
    return file.read_text(errors="replace")[-TAIL:] if file.exists() else ""


def _status(code: int | None) -> str:
    if code is None:
        return TIMED_OUT
    return LOST if code in FROM_OUTSIDE else FAILED if code else DONE
