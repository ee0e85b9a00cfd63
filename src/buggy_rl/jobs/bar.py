"""Progress bars on a terminal, plain lines in a pipe or a log file; jobs behind one."""

import os
import sys
import time
from collections.abc import Sequence
from typing import Any

from tqdm import std

from buggy_rl.jobs.job import Job
from buggy_rl.jobs.launching import Launching, run_jobs

POLL = 1.0  # [s] between two looks; the bar itself writes ten times a second at most
PERIOD = "TQDM_MININTERVAL"  # environment variable, as tqdm's own: [s] between two plain lines
EVERY = 10.0  # [s] unless the variable says otherwise


class tqdm(std.tqdm):  # noqa: N801 - scripts use it in the place of tqdm's
    """A bar of tqdm that writes a plain line now and then where its file is no terminal.

    There a bar would be a line for each of its states. The first line comes after `EVERY` seconds,
    the last one at the end.
    """

    def __init__(self, *args: Any, **keywords: Any) -> None:
        file = keywords.get("file") or sys.stderr
        self.plain = not file.isatty()
        self._told = time.perf_counter()
        self._every = float(os.environ.get(PERIOD, EVERY))
        if self.plain:
            keywords["mininterval"] = self._every
        super().__init__(*args, **keywords)

    def display(self, msg: str | None = None, pos: int | None = None) -> None:
        if not self.plain:
            super().display(msg, pos)
            return
        now = time.perf_counter()
        if now - self._told >= self._every:
            self._told = now
            self._write_line()

    def clear(self, nolock: bool = False) -> None:
        if not self.plain:  # a plain line stays
            super().clear(nolock)

    def close(self) -> None:
        if not self.plain or self.disable:
            super().close()
            return
        self.disable = True
        self._decr_instances(self)  # pyright: ignore[reportAttributeAccessIssue]
        if self.leave:
            self._write_line()

    def _write_line(self) -> None:
        self.fp.write(f"{str(self).strip()}\n")
        self.fp.flush()


def run_with_bar(
    title: str, jobs: Sequence[Job], unit: str, workers: int, launching: Launching
) -> None:
    """Runs jobs as `run_jobs` does; what an interrupted run has done counts from the start."""
    reached = {job.folder: job.work * job.done for job in jobs}
    total, initial = sum(job.work for job in jobs), sum(reached.values())
    with tqdm(desc=title, total=total, initial=initial, unit=unit, unit_scale=total > 1e4) as bar:
        for job, share, _ in run_jobs(jobs, workers, launching, POLL):
            bar.set_postfix_str(job.name, refresh=False)
            now = max(int(job.work * share), reached[job.folder])
            bar.update(now - reached[job.folder])
            reached[job.folder] = now
