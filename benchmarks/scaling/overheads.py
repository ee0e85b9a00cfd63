"""What running a job somewhere costs beside the job: bytes, start-up, the driver's time."""

import pickle
import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.jobs import Job, Launching, read_outcome, run_jobs

IMPORTS = (
    "import buggy_rl.policies.training.run"  # PyTorch, TorchRL and the package: what any job needs
)
NOTHING = "pass"


@dataclass(frozen=True)
class Overheads:
    """Of one launcher."""

    launcher: str
    command_bytes: int
    """Through the launcher, a job."""
    cluster_seconds: float
    """From the call to the first job's start, beside a later job's: a cluster's own start."""
    job_seconds: float
    """Wall time of a job that does nothing, one at a time."""
    import_seconds: float
    """Processor time of a job that only imports what every job needs."""
    driver_seconds: float
    """Processor time of the driver, a job."""


def jobs_of(source: str, count: int, folder: Path) -> list[Job]:
    """Jobs that run a line of Python."""
    folder.mkdir(parents=True, exist_ok=True)
    script = folder / "job.py"
    script.write_text(source)
    return [Job(f"{n}", folder / f"{n}", (str(script),)) for n in range(count)]


def overheads(launching: Launching, folder: Path, count: int) -> Overheads:
    """Measures one launcher with jobs that do nothing.

    Args:
        launching: The launcher.
        folder: For the jobs.
        count: Jobs.
    """
    empty = jobs_of(NOTHING, count, folder / "empty")
    command = empty[0].prepared(1)
    begun, driver = time.perf_counter(), time.process_time()
    ends = [time.perf_counter() for p in run_jobs(empty, 1, launching, 0.01) if p.outcome]
    spent = time.process_time() - driver
    each = (ends[-1] - ends[0]) / (count - 1)
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    list(run_jobs(jobs_of(IMPORTS, 3, folder / "imports"), 1, Launching(cores=1), 0.01))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    first = ends[0] - begun - each
    size = len(pickle.dumps(command))
    return Overheads(launching.launcher, size, first, each, used / 3, spent / count)


def written(folders: Sequence[Path]) -> tuple[float, float]:
    """Files and bytes that a job leaves in its folder, on average."""
    files = [file for folder in folders for file in folder.rglob("*") if file.is_file()]
    return len(files) / len(folders), sum(f.stat().st_size for f in files) / len(folders)


def seconds_of(folders: Sequence[Path]) -> float:
    """Run time of a job, on average."""
    return sum(read_outcome(folder)["seconds"] for folder in folders) / len(folders)
