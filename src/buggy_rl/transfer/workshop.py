"""Jobs side by side, and what to do when one fails or all are stopped."""

import signal
import subprocess
import time
from collections.abc import Iterator, Sequence

from buggy_rl.blind_test.exam import end
from buggy_rl.transfer.job import Job

LOOK = 1.0  # [s] between two looks at what runs


def worked(jobs: Sequence[Job], workers: int, look: float = LOOK) -> Iterator[tuple[Job, float]]:
    """Runs jobs that are not done, so many at a time; stopped, it ends what runs.

    Yields:
        A job and its share that is done, whenever it was looked at; 1 once, at its end.

    Raises:
        ValueError: Some failed; raised when the others are done.
    """
    waiting = [job for job in jobs if not job.done]
    running: dict[str, tuple[Job, subprocess.Popen]] = {}
    failed = []
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                job = waiting.pop(0)
                running[job.name] = job, job.start()
            time.sleep(look)
            for job, process in list(running.values()):
                if process.poll() is None:
                    yield job, job.share()
                    continue
                del running[job.name]
                if process.returncode:
                    failed.append(f"{job.name}: {job.last_words()}")
                else:
                    job.finish()
                yield job, 1.0
    finally:
        for _, process in running.values():
            end(process, signal.SIGTERM)
    if failed:
        raise ValueError(f"{len(failed)} of {len(jobs)} failed\n" + "\n".join(failed))
