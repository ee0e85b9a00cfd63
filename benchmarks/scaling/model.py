"""Where more workers stop paying: a model on paper, of measured numbers."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Work:
    """Independent jobs, all alike."""

    name: str
    jobs: int
    seconds: float
    """Processor time of a job, its imports left out."""
    bytes: float
    """A job reads from and writes to the shared disk."""


@dataclass(frozen=True)
class Costs:
    """Beside the work."""

    cluster: float
    """[s] once, to start the cluster."""
    start: float
    """[s] a job: a process that imports what it needs."""
    driver: float
    """[s] a job, of the one driver."""
    disk: float
    """[bytes/s] of the shared disk."""


def wall(work: Work, costs: Costs, workers: int) -> float:
    """Wall time [s] = cluster + max(W jobs side by side, the driver, the disk).

    Assumes equal jobs, one core a worker, no loss, a disk that all share evenly.
    """
    beside = -(-work.jobs // workers) * (costs.start + work.seconds)
    return costs.cluster + max(
        beside, work.jobs * costs.driver, work.jobs * work.bytes / costs.disk
    )


def efficiency(work: Work, costs: Costs, workers: int) -> float:
    """Share of the workers' time that is work."""
    return work.jobs * work.seconds / (workers * wall(work, costs, workers))


def most_workers(work: Work, costs: Costs) -> int:
    """Workers beyond which the driver or the disk is the limit."""
    each = max(costs.driver, work.bytes / costs.disk)
    return max(1, int((costs.start + work.seconds) / each))


def needed(work: Work, costs: Costs, within: float) -> int | None:
    """Fewest workers that are done within so many seconds; None where no number is."""
    for workers in range(1, work.jobs + 1):
        if wall(work, costs, workers) <= within:
            return workers
    return None
