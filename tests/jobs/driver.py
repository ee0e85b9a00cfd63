"""A driver that a test kills: python -m tests.jobs.driver LAUNCHER FOLDER."""

import signal
import sys
from pathlib import Path

from buggy_rl.core.config import run
from buggy_rl.jobs import run_jobs
from tests.jobs.counting import counting
from tests.jobs.launchers import launching

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored below a shell's background
    jobs = counting(Path(sys.argv[2]), 2, pause=1.0)
    run(lambda: list(run_jobs(jobs, 2, launching(sys.argv[1]))))
