"""Runs jobs on this machine, Ray or Slurm, and starts the lost ones again."""

import importlib
import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, NamedTuple, Protocol, Self

from buggy_rl.core.extras import needs
from buggy_rl.jobs.job import Job
from buggy_rl.jobs.process import (
    DONE,
    LOST,
    POLL,
    STOPPED,
    Command,
    Outcome,
    Process,
    cores,
    last_words,
    read_outcome,
)

LAUNCHERS = ("local", "ray", "submitit")


@dataclass(frozen=True, kw_only=True)  # so that fields of those who inherit it come first
class Launching:
    """Place where independent jobs run; their results do not depend on it."""

    launcher: Literal["local", "ray", "submitit"] = "local"
    """local, ray (a cluster of machines) or submitit (Slurm); docs/policies.md."""
    cluster: dict[str, Any] = field(default_factory=dict)
    """Options of the launcher: of ray.init, such as cluster.address=auto, or of submitit's
    executor, such as cluster.slurm_partition=long; cluster.cluster=local runs submitit here."""
    cores: int = 0
    """Cores of a job; 0 for an equal share of this machine (local), one (ray, submitit)."""
    retries: int = 5
    """Times that a job is started again after its worker was lost."""

    def share(self, workers: int) -> int:
        """Cores that each of so many jobs may keep busy."""
        return self.cores or (max(1, cores() // workers) if self.launcher == "local" else 1)


class Handle(Protocol):
    """A job that has been started somewhere."""

    def poll(self) -> str | None:
        """None while it waits or runs, then its status."""
        ...

    def end(self) -> None:
        """Ends it where it still runs, and returns when it has ended."""
        ...


class Launcher(Protocol):
    """Starts jobs."""

    def start(self, command: Command) -> Handle:
        """Starts one, at once or when a place is free."""
        ...

    def close(self) -> None:
        """Ends whatever this launcher has started beside the jobs."""
        ...


class Local:
    """Processes of this machine."""

    def start(self, command: Command) -> Process:
        """Starts one at once."""
        return Process(command)

    def close(self) -> None:
        """Does nothing: only jobs were started."""


def make_launcher(launching: Launching, workers: int) -> Launcher:
    """The launcher that a config names.

    Args:
        launching: Its config.
        workers: Jobs that will run at the same time.

    Raises:
        ValueError: There is no such launcher, its package is not installed, or its options are
            not taken.
    """
    if launching.launcher not in LAUNCHERS:
        raise ValueError(f"no launcher {launching.launcher!r}; available: {', '.join(LAUNCHERS)}")
    if launching.launcher == "local":
        if launching.cluster:
            raise ValueError(
                f"cluster={dict(launching.cluster)} belongs to launcher=ray or launcher=submitit; "
                "launcher=local has no such options"
            )
        return Local()
    module = importlib.import_module(f"buggy_rl.jobs.on_{launching.launcher}")
    return module.launcher(launching.cluster, workers, launching.share(workers))


def required(package: str, what: str) -> Any:
    """Imports a package of the extra `scale`.

    Raises:
        MissingExtraError: It is not installed.
    """
    return needs(package, "scale", what)


def refuse_unknown_options(options: Mapping[str, Any], known: set[str], what: str) -> None:
    """Compares the names of options with those that a launcher takes.

    Raises:
        ValueError: One is not among them.
    """
    if unknown := sorted(set(options) - known):
        raise ValueError(
            f"cluster has no options {unknown} for {what}; available: {', '.join(sorted(known))}"
        )


LOCAL = Launching()


class Progress(NamedTuple):
    """A job, the share of it that is done, and its outcome once it has ended."""

    job: Job
    share: float
    outcome: Outcome | None = None


class _Started:
    """A job that runs, and how often it had to be started."""

    def __init__(self, job: Job, handle: Handle) -> None:
        self.job, self.handle, self.begun, self.losses = job, handle, time.monotonic(), 0


class Running:
    """Jobs that run somewhere; left by any way, it ends them and whatever was started for them.

    Args:
        workers: Jobs that run at the same time.
        launching: Where.

    Raises:
        ValueError: There is no such launcher, or its package or cluster is missing.
    """

    def __init__(self, workers: int, launching: Launching = LOCAL) -> None:
        if workers < 1:
            raise ValueError(f"workers={workers}: must be 1 at least")
        self.workers, self._launching = workers, launching
        self._cores = launching.share(workers)
        self._launcher = make_launcher(launching, workers)
        self._started: dict[Path, _Started] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            for started in self._started.values():
                started.handle.end()
        finally:
            self._launcher.close()

    @property
    def free(self) -> int:
        """Jobs that can be started now."""
        return self.workers - len(self._started)

    def start(self, job: Job) -> None:
        """Starts a job, from its checkpoint where there is one."""
        command = job.prepared(self._cores)
        self._started[job.folder] = _Started(job, self._launcher.start(command))

    def stop(self, job: Job) -> Outcome:
        """Ends a job that runs; it has no outcome on the disk."""
        started = self._started.pop(job.folder)
        started.handle.end()
        return _ended(started, STOPPED)

    def poll(self) -> Iterator[Progress]:
        """Progress of every job that runs; of one that has ended, with its outcome, once."""
        for started in list(self._started.values()):
            job, status = started.job, started.handle.poll()
            if status == LOST and started.losses < self._launching.retries:
                started.losses += 1
                started.handle = self._launcher.start(job.prepared(self._cores))
                status = None
            if status is None:
                yield Progress(job, job.share())
                continue
            del self._started[job.folder]
            yield Progress(job, 1.0, _ended(started, status))


def run_jobs(
    jobs: Sequence[Job], workers: int, launching: Launching = LOCAL, poll: float = POLL
) -> Generator[Progress, None, None]:
    """Runs the jobs that are not done, `workers` at a time.

    A job whose worker is lost (killed, its machine gone) is started again, from its checkpoint,
    up to `launching.retries` times. Closed or interrupted, it ends the running processes with all
    that they have started; these jobs have no outcome and are run again the next time.

    Yields:
        The progress of every running job once a poll; the outcome once, at its end.

    Raises:
        ValueError: Jobs that are not `final` have failed, or jobs were lost too often; raised when
            all have ended.
    """
    waiting = [job for job in jobs if not job.done]
    if not waiting:
        return
    failed = []
    with Running(workers, launching) as running:
        while waiting or running.free < running.workers:
            while waiting and running.free:
                running.start(waiting.pop(0))
            time.sleep(poll)
            for progress in running.poll():
                outcome = progress.outcome
                if outcome and _failed(progress.job, outcome):
                    failed.append(_complaint(progress.job, outcome))
                yield progress
    if failed:
        raise ValueError(f"{len(failed)} of {len(jobs)} failed\n" + "\n".join(failed))


def _ended(started: _Started, status: str) -> Outcome:
    """The outcome, read from the disk where there is one."""
    if found := read_outcome(started.job.folder):
        return Outcome(**found)
    seconds, said = time.monotonic() - started.begun, last_words(started.job.folder)
    if status == LOST:
        said += (
            f"\nits worker was killed {started.losses + 1} times: was memory short? Use fewer "
            "workers, or raise retries"
        )
    return Outcome(status, round(seconds, 1), said)


def _failed(job: Job, outcome: Outcome) -> bool:
    """Whether the run is to end with an error: what was lost has no outcome that counts."""
    return outcome.status == LOST or (outcome.status != DONE and not job.final)


def _complaint(job: Job, outcome: Outcome) -> str:
    return f"{job.name}: {outcome.status}: {' '.join(outcome.last_words.split())[-300:]}"
