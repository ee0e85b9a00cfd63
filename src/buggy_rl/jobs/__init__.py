"""Independent work in processes of its own: scripts that are run once and remembered, functions.

A job writes into its folder `log.txt` (all that its script printed), `job.json` (its command and
the hashes of its inputs, written at its start) and `outcome.json` (how it ended). A job whose
outcome is there is not run again. Where it runs (`launching`) changes nothing of what it writes:
every launcher starts the same command in the same way (`process`).
"""

from buggy_rl.jobs.calls import results
from buggy_rl.jobs.job import Job, digest
from buggy_rl.jobs.launching import Launching, Progress, Running, run_jobs
from buggy_rl.jobs.process import CORES, LOG, ONE_THREAD, OUTCOME, Outcome, cores, end, read_outcome

__all__ = [
    "CORES",
    "LOG",
    "ONE_THREAD",
    "OUTCOME",
    "Job",
    "Launching",
    "Outcome",
    "Progress",
    "Running",
    "cores",
    "digest",
    "end",
    "read_outcome",
    "results",
    "run_jobs",
]
