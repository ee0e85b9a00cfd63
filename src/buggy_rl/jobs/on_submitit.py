"""Jobs submitted to Slurm by submitit, or to its local executor.

Each job's submission, with submitit's own logs, lies in its folder under `submitit/`. A job that is
preempted or reaches its time limit is put back into the queue by submitit and goes on from its
checkpoint.
"""

import signal
import time
from collections.abc import Mapping
from typing import Any

from buggy_rl.jobs.launching import required
from buggy_rl.jobs.process import (
    GRACE,
    LOST,
    POLL,
    STOP,
    Command,
    attend,
    read_outcome,
    wait_until_free,
)

FOLDER = "submitit"
TIMEOUT = 24 * 60  # [min] of one submission, where cluster.timeout_min says nothing else


def launcher(options: Mapping[str, Any], workers: int, cores: int) -> "OnSubmitit":
    """Submits to `options["cluster"]`: slurm where there is none, local, debug.

    The other options are those of submitit's `AutoExecutor.update_parameters`.
    """
    submitit = required("submitit", "launcher=submitit")
    return OnSubmitit(submitit, {"timeout_min": TIMEOUT, "cpus_per_task": cores, **options})


class OnSubmitit:
    """Submits jobs, each with an executor that keeps its files in the job's folder."""

    def __init__(self, submitit: Any, options: dict[str, Any]) -> None:
        self._submitit, self._options = submitit, options
        self._cluster = options.pop("cluster", "slurm")

    def start(self, command: Command) -> "SubmittedHandle":
        """Submits one job.

        Raises:
            ValueError: submitit does not take the options, or finds no such cluster.
        """
        if (command.folder / STOP).exists():
            wait_until_free(command.folder)
            (command.folder / STOP).unlink()
        try:
            executor = self._submitit.AutoExecutor(command.folder / FOLDER, cluster=self._cluster)
            executor.update_parameters(**self._options)
        except (NameError, TypeError, ValueError, RuntimeError) as error:
            raise ValueError(
                f"submitit, cluster.cluster={self._cluster}: {' '.join(str(error).split())}"
            ) from None
        job = executor.submit(Attended(), command)
        return SubmittedHandle(self._submitit, job, command)

    def close(self) -> None:
        """Does nothing: only jobs were started."""


class Attended:
    """`attend`, which submitit may interrupt and put back into the queue."""

    def __call__(self, command: Command) -> str:
        """Runs a job; its status."""
        # submitit lets SIGTERM pass; a worker that is cancelled ends its job by it.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        return attend(command)

    def checkpoint(self, command: Command) -> Any:
        """Called by submitit before the job is interrupted: the same again, from its checkpoint."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self, command)


class SubmittedHandle:
    """A submitted job."""

    def __init__(self, submitit: Any, job: Any, command: Command) -> None:
        self._submitit, self._job, self._command = submitit, job, command

    def poll(self) -> str | None:
        """None while it waits or runs; `lost` where it ended without a result."""
        if not self._job.done():
            return None
        error = self._job.exception()
        if error is None:
            return self._job.result()
        if isinstance(error, self._submitit.core.utils.FailedJobError):
            said = " ".join(str(error).split())
            raise ValueError(f"{self._command.folder}: its submission failed: {said}")
        (self._command.folder / STOP).touch()  # what is left of it must not write beside the next
        return read_outcome(self._command.folder).get("status", LOST)

    def end(self) -> None:
        """Tells the worker to end it, or takes it out of the queue."""
        if self._job.done():
            return
        (self._command.folder / STOP).touch()
        until = time.monotonic() + 2 * GRACE
        while not self._job.done() and time.monotonic() < until:
            time.sleep(POLL)
        if not self._job.done():
            self._job.cancel()
