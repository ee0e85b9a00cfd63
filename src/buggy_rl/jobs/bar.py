"""Jobs behind a progress bar."""

from collections.abc import Sequence

from buggy_rl.jobs.job import Job
from buggy_rl.jobs.launching import Launching
from buggy_rl.jobs.running import run_jobs

POLL = 1.0  # [s] between two looks; the bar itself writes ten times a second at most


def run_with_bar(
    title: str, jobs: Sequence[Job], unit: str, workers: int, launching: Launching
) -> None:
    """Runs jobs as `run_jobs` does; what an interrupted run has done counts from the start."""
    from tqdm import tqdm

    reached = {job.folder: job.work * job.done for job in jobs}
    total, initial = sum(job.work for job in jobs), sum(reached.values())
    with tqdm(desc=title, total=total, initial=initial, unit=unit, unit_scale=total > 1e4) as bar:
        for job, share, _ in run_jobs(jobs, workers, launching, POLL):
            bar.set_postfix_str(job.name, refresh=False)
            now = max(int(job.work * share), reached[job.folder])
            bar.update(now - reached[job.folder])
            reached[job.folder] = now
