"""Functions called in processes of their own, as jobs: arguments and result lie in files."""

import hashlib
import json
import pickle
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from buggy_rl.core.files import remove_folder, write_atomically
from buggy_rl.jobs.job import RECORD, Job
from buggy_rl.jobs.launching import LOCAL, Launching, run_jobs
from buggy_rl.jobs.process import DONE, LOCK, LOG, OUTCOME, STOP

CALL, RESULT = "call.pkl", "result.json"
# Files of a call's folder; earlier versions wrote a result that ran code when it was read.
OWN = (CALL, RESULT, "result.pkl", RECORD, OUTCOME, LOG, LOCK, STOP)


def results(
    function: Callable[..., Any],
    calls: Mapping[str, tuple],
    folder: Path,
    workers: int,
    launching: Launching = LOCAL,
) -> Iterator[Any]:
    """Results of a function for each tuple of arguments, in the order in which they come.

    Every call is a job with one PyTorch thread in FOLDER/NAME, which is removed when its result was
    taken. A result that is there from an interrupted run is taken without a call.

    Args:
        function: Can be pickled; its result is plain values, as JSON has them; a path becomes
            its name.
        calls: A name of each call, which names its folder, and its arguments, which can be pickled
            and whose `repr` says what they are.
        folder: Of the calls.
        workers: Calls at a time.
        launching: Where.

    Raises:
        ValueError: A call has failed; raised when all have ended.
    """
    jobs = [_job(function, name, arguments, folder) for name, arguments in calls.items()]
    left = [job for job in jobs if not job.done]
    for job in jobs:
        if job not in left:
            yield from _taken(job)
    for progress in run_jobs(left, workers, launching):
        if progress.outcome and progress.outcome.status == DONE:
            yield from _taken(progress.job)
    remove_folder(folder)


def _job(function: Callable[..., Any], name: str, arguments: tuple, folder: Path) -> Job:
    """The job of a call, with its folder begun anew unless it is that of the very same call."""
    own = folder / name
    said = f"{function.__module__}.{function.__qualname__}{arguments!r}"
    digest = hashlib.sha256(said.encode()).hexdigest()
    job = Job(name, own, ("-m", "buggy_rl.jobs.call", str(own.resolve()), digest))
    if own.exists() and not ((own / RECORD).exists() and digest in (own / RECORD).read_text()):
        remove_folder(own, OWN)
    if not (own / RESULT).exists():
        (own / OUTCOME).unlink(missing_ok=True)
        # Also where one is there: it would be run, whoever wrote it.
        content = pickle.dumps((list(sys.path), pickle.dumps((function, arguments))))
        write_atomically(own / CALL, content)
    return job


def _taken(job: Job) -> Iterator[Any]:
    """The result; its folder goes when the receiver asks for the next one, so has kept it."""
    file = job.folder / RESULT
    try:
        result = json.loads(file.read_text())
    except ValueError as error:
        raise ValueError(f"{file} is no result of a call: take {job.folder} away") from error
    yield result
    remove_folder(job.folder, OWN)
