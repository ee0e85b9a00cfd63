"""Jobs of the proof in this process, and no larger than they must be.

That jobs run in processes of their own has its tests in tests/jobs, what a simulator shows of
itself in tests/effects, here taken as typical, and the report in tests/diagnosis, here left out.
Networks that an answer is compared with learn for a tenth of the time.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

from buggy_rl.api import diagnosis
from buggy_rl.commands import diagnose
from buggy_rl.core.files import write_json
from buggy_rl.diagnosis.run.budget import FULL
from buggy_rl.diagnosis.search.joint import joint_search
from buggy_rl.effects import measuring
from buggy_rl.estimation import baseline
from buggy_rl.jobs import OUTCOME, Job, Outcome, Progress
from buggy_rl.proof import running
from buggy_rl.proof.calibrate import development

QUICK = ("minutes=0.001", "workers=1")
"""The least search, in one process."""
SHORT = replace(FULL, rounds=1, iterations=4, refitted=0, sizes=(0.7,))
"""A short search, where none can be asked for."""


@contextmanager
def jobs_here() -> Iterator[None]:
    """Runs calls and diagnoses in this process."""
    with (
        patch.object(measuring, "CHAINS", ()),
        patch.object(diagnosis, "report", lambda *_: ""),
        patch.object(baseline, "STEPS", 50),
        patch.object(development, "results", called),
        patch.object(development, "joint_search", partial(joint_search, budget=SHORT)),
        patch.object(running, "results", called),
        patch.object(running, "run_jobs", diagnosed),
    ):
        yield


def called(function, calls: Mapping[str, tuple], folder: Path, *_) -> Iterator:
    """As `buggy_rl.jobs.results`."""
    del folder
    for arguments in calls.values():
        yield function(*arguments)


def diagnosed(jobs: Sequence[Job], *_) -> Iterator[Progress]:
    """As `buggy_rl.jobs.run_jobs`, of diagnoses."""
    for job in jobs:
        assert not job.done
        assert job.cwd is not None
        script, *options = job.command[job.command.index("--") + 1 :]  # here nothing is confined
        job.folder.mkdir(parents=True)
        with chdir(job.cwd), patch.object(sys, "argv", [script, *options, *QUICK]):
            diagnose.main()
        outcome = Outcome("done", 1.0, "")
        write_json(job.folder / OUTCOME, {"status": "done", "seconds": 1.0, "last_words": ""})
        yield Progress(job, 1.0, outcome)
