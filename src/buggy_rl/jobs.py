"""Work in processes of its own: scripts that are run once and remembered, and functions.

A job writes into its folder `log.txt` (all that its script printed), `job.json` (its command and
the hashes of its inputs, written at its start) and `outcome.json` (how it ended). A job whose
outcome is there is not run again.
"""

import hashlib
import json
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

from buggy_rl.files import write_json

RECORD = "job.json"
OUTCOME = "outcome.json"
LOG = "log.txt"
POLL = 0.2  # [s] between two looks at running processes
GRACE = 10.0  # [s] from SIGTERM to SIGKILL
TAIL = 2000  # [characters] of the log that the outcome keeps
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"}
CORES = "BUGGY_RL_CORES"
"""Environment variable: cores that a process may keep busy, where several share the machine."""


@dataclass(frozen=True)
class Outcome:
    """How a job ended."""

    status: str
    """done, failed or timed out."""
    seconds: float
    """Run time [s]."""
    last_words: str
    """End of the log."""


@dataclass(frozen=True)
class Job:
    """A Python script with its options, and the folder that it writes to."""

    name: str
    folder: Path
    command: tuple[str, ...]
    """The script and its options."""
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
        if record["command"] != self._recorded:
            raise ValueError(
                f"{self.folder} was begun by {' '.join(record['command'])!r}, now wanted is "
                f"{' '.join(self._recorded)!r}: use another output, or move the folder away"
            )
        if changed := [name for name, was in record["inputs"].items() if digest(name) != was]:
            raise ValueError(
                f"{self.folder} was begun before {', '.join(changed)} had changed: use another "
                "output, or move the folder away"
            )
        # Before there was an outcome.json, job.json said whether a job was done.
        return outcome.get("status") == "done" or record.get("done", False)

    def start(self, cores: int = 1) -> subprocess.Popen:
        """Starts the script in a session of its own; from its checkpoint where there is one.

        Args:
            cores: That it may keep busy.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / OUTCOME).unlink(missing_ok=True)
        if not self.final:
            inputs = {name: digest(name) for name in self.inputs}
            write_json(self.folder / RECORD, {"command": self._recorded, "inputs": inputs})
        resumed = bool(self.checkpoint) and (self.folder / self.checkpoint).exists()
        with open(self.folder / LOG, "a") as log:
            return subprocess.Popen(
                [sys.executable, *self.command, *(["resume=true"] if resumed else [])],
                cwd=self.cwd,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | ONE_THREAD | {CORES: str(cores)},
            )

    def finish(self, status: str, seconds: float) -> Outcome:
        """Writes how the job ended."""
        last_words = (self.folder / LOG).read_text(errors="replace")[-TAIL:]
        outcome = Outcome(status, round(seconds, 1), last_words)
        write_json(self.folder / OUTCOME, asdict(outcome))
        return outcome

    @property
    def _recorded(self) -> list[str]:
        """The command, without the folder that the script is in."""
        return [Path(self.command[0]).name, *self.command[1:]]


class Progress(NamedTuple):
    """A job, the share of it that is done, and its outcome once it has ended."""

    job: Job
    share: float
    outcome: Outcome | None = None


def run_jobs(
    jobs: Sequence[Job], workers: int, poll: float = POLL
) -> Generator[Progress, None, None]:
    """Runs the jobs that are not done, `workers` at a time.

    Closed or interrupted, it ends the running processes with all that they have started; these jobs
    have no outcome and are run again the next time.

    Yields:
        The progress of every running job once a poll; the outcome once, at its end.

    Raises:
        ValueError: Jobs that are not `final` have failed; raised when all have ended.
    """
    waiting = [job for job in jobs if not job.done]
    each = max(1, cores() // workers)
    running: list[tuple[Job, subprocess.Popen, float]] = []
    failed = []
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                job = waiting.pop(0)
                running.append((job, job.start(each), time.monotonic()))
            time.sleep(poll)
            for entry in list(running):
                job, process, begun = entry
                seconds, code = time.monotonic() - begun, process.poll()
                if code is None and seconds < job.limit:
                    yield Progress(job, job.share())
                    continue
                if code is None:
                    end(process)
                running.remove(entry)
                status = "timed out" if code is None else "failed" if code else "done"
                outcome = job.finish(status, seconds)
                if outcome.status != "done" and not job.final:
                    failed.append(f"{job.name}: {' '.join(outcome.last_words.split())[-300:]}")
                yield Progress(job, 1.0, outcome)
    finally:
        for _, process, _ in running:
            end(process)
    if failed:
        raise ValueError(f"{len(failed)} of {len(jobs)} failed\n" + "\n".join(failed))


def end(process: subprocess.Popen) -> None:
    """Ends a process that leads a session, with all that it has started."""
    try:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(GRACE)
    except subprocess.TimeoutExpired:
        pass
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        return
    process.wait()


def read_outcome(folder: Path) -> dict[str, Any]:
    """The outcome in a job's folder; empty where there is none."""
    file = folder / OUTCOME
    return json.loads(file.read_text()) if file.exists() else {}


def digest(file: str) -> str:
    """SHA-256 of a file's content; empty where there is no such file."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if Path(file).is_file() else ""


def cores() -> int:
    """Cores that this process may keep busy: its share where it is a job, else its affinity.

    Raises:
        ValueError: The environment variable is no number above 0.
    """
    given = os.environ.get(CORES, "")
    if given and not (given.isdecimal() and int(given)):
        raise ValueError(f"{CORES}={given}: must be a number of cores above 0, or not set")
    return int(given) if given else len(os.sched_getaffinity(0))


def in_processes(
    function: Callable[..., Any], arguments: Sequence[tuple], workers: int
) -> Iterator[Any]:
    """Results of a function for each tuple of arguments, in the order in which they come.

    Every worker is a process with one PyTorch thread. Closed or interrupted, they are ended.
    """
    context = multiprocessing.get_context("spawn")
    share = max(1, cores() // workers)
    with ProcessPoolExecutor(workers, context, _use_one_thread, (share,)) as pool:
        futures = [pool.submit(function, *each) for each in arguments]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()  # else they outlive a parent that is killed by SIGTERM
            raise


def _use_one_thread(cores: int) -> None:
    import torch

    os.environ[CORES] = str(cores)
    torch.set_num_threads(1)
