"""Cores that a process may keep busy, where several share a machine."""

import os

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
