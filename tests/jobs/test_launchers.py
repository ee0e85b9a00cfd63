"""Every launcher: the same results, no job lost, no process left over, clear errors."""

import fcntl
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from buggy_rl.core.config import ConfigError, build
from buggy_rl.jobs import Job, Launching, leash, read_outcome, results, run_jobs
from buggy_rl.jobs.launching import make_launcher
from buggy_rl.jobs.process import LOCK, wait_until_free
from tests.jobs.counting import STEPS, Killer, counting, mine, right
from tests.jobs.launchers import launching

ROOT = Path(__file__).parents[2]
ELSEWHERE = [
    pytest.param("ray", marks=pytest.mark.slow),
    pytest.param("submitit", marks=pytest.mark.slow),
]
EVERY = ["local", *ELSEWHERE]
ABOVE = {"local": 0, "ray": 1, "submitit": 2}
"""Processes of a launcher between the script and its driver: a worker; its controller too."""
KILLS = 20


def left_over(marker: str, patience: float = 15.0) -> list[str]:
    """Command lines that name the marker and do not end by themselves."""
    until = time.monotonic() + patience
    while (found := mine(marker)) and time.monotonic() < until:
        time.sleep(0.2)
    return found


@pytest.fixture
def no_cluster(monkeypatch):
    """Ray is not told of a cluster that happens to run."""
    monkeypatch.delenv("RAY_ADDRESS", raising=False)


@pytest.mark.parametrize("name", EVERY)
def test_every_launcher_writes_what_a_job_would_write_by_itself(tmp_path, no_cluster, name):
    jobs = counting(tmp_path, 3, pause=0.0)
    ended = [p.outcome.status for p in run_jobs(jobs, 2, launching(name)) if p.outcome]
    assert ended == ["done"] * 3
    assert right(jobs) == [True] * 3
    assert list(run_jobs(jobs, 2, launching("local"))) == []  # done is done, whoever did it
    assert left_over(str(tmp_path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["local", "ray", "submitit"])
def test_twenty_workers_killed_at_random_lose_no_job_and_one_step_each(tmp_path, no_cluster, name):
    jobs = counting(tmp_path, 12, pause=0.1)
    killer = Killer(jobs, KILLS, ABOVE[name])
    killer.start()
    list(run_jobs(jobs, 2, launching(name, retries=KILLS)))
    killer.over.set()
    killer.join()
    assert right(jobs) == [True] * len(jobs)
    assert len(killer.hits) == KILLS
    done = sum(len((job.folder / "steps").read_text().splitlines()) for job in jobs)
    assert len(jobs) * STEPS <= done <= len(jobs) * STEPS + KILLS
    assert left_over(str(tmp_path)) == []


@pytest.mark.parametrize("name", EVERY)
def test_a_job_that_is_killed_too_often_is_named(tmp_path, no_cluster, name):
    script = tmp_path / "dies.py"
    script.write_text("import os, signal; os.kill(os.getpid(), signal.SIGKILL)")
    folder = tmp_path / "bad"
    bad = Job("bad", folder, (str(script),), final=True)
    with pytest.raises(ValueError, match=r"bad: lost: .*killed 3 times: was memory short\?"):
        list(run_jobs([bad], 1, launching(name, retries=2)))
    assert read_outcome(folder) == {}  # that says nothing about the job: it is run again


@pytest.mark.parametrize("name", EVERY)
def test_a_job_that_always_fails_is_named_and_not_started_again(tmp_path, no_cluster, name):
    script = tmp_path / "fails.py"
    script.write_text("print('once'); raise SystemExit('no root found')")
    bad = Job("bad", tmp_path / "bad", (str(script),))
    with pytest.raises(ValueError, match=r"1 of 1 failed\nbad: failed: once no root found"):
        list(run_jobs([bad], 1, launching(name, retries=3)))
    assert read_outcome(bad.folder)["status"] == "failed"


def test_a_crash_of_the_program_is_a_failure_and_no_lost_worker(tmp_path):
    script = tmp_path / "crashes.py"
    script.write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    bad = Job("bad", tmp_path / "bad", (str(script),), final=True)
    (progress,) = (p for p in run_jobs([bad], 1, launching("local", retries=3)) if p.outcome)
    assert progress.outcome.status == "failed"


@pytest.mark.parametrize(
    ("name", "blow"),
    [
        ("local", signal.SIGKILL),
        *(
            pytest.param(name, blow, marks=pytest.mark.slow)
            for name in ("ray", "submitit")
            for blow in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
        ),
    ],
)
def test_no_process_outlives_a_driver_that_is_ended(tmp_path, no_cluster, name, blow):
    command = [sys.executable, "-m", "tests.jobs.driver", name, str(tmp_path)]
    driver = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
    while not all((tmp_path / f"job_{n}" / "pid").exists() for n in range(2)):
        assert driver.poll() is None
        time.sleep(0.05)
    os.kill(driver.pid, blow)
    assert driver.wait(60) != 0
    # Of SIGKILL submitit hears nothing: its jobs are to outlive a driver, and end when done.
    outlives = name == "submitit" and blow == signal.SIGKILL
    assert left_over(str(tmp_path), STEPS + 30.0 if outlives else 15.0) == []
    if outlives:
        assert right(counting(tmp_path, 2, pause=1.0)) == [True, True]


def test_a_job_does_not_run_twice_at_a_time(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(leash, "PATIENCE", 0.1)
    with open(tmp_path / LOCK, "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(ValueError, match="lost worker still works on it"):
            wait_until_free(tmp_path, patience=0.1)
        with pytest.raises(SystemExit):
            leash.hold_leash(str(tmp_path / LOCK))
    assert "another process works on this job" in capsys.readouterr().err
    wait_until_free(tmp_path, patience=0.1)


def test_an_unknown_launcher_is_refused_with_those_that_there_are(tmp_path):
    with pytest.raises(ConfigError, match=r"launcher.*slurm"):
        build(Launching, ["launcher=slurm"])
    unknown = replace(Launching(), launcher="slurm")  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="no launcher 'slurm'; available: local, ray, submitit"):
        list(run_jobs(counting(tmp_path, 1), 1, unknown))


@pytest.mark.parametrize("name", ["ray", "submitit"])
def test_a_missing_package_is_named_with_the_extra_that_has_it(monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    with pytest.raises(ValueError, match=rf"needs the package {name}.*'buggy_rl\[scale\]'"):
        make_launcher(launching(name), 1)


@pytest.mark.parametrize(
    ("name", "cluster", "message"),
    [
        ("local", {"address": "auto"}, "launcher=local has no such options"),
        ("ray", {"adress": "auto"}, r"no options \['adress'\].*address"),
        ("ray", {"address": "127.0.0.1:1"}, "no Ray cluster at 127.0.0.1:1"),
        ("submitit", {"cluster": "cloud"}, "submitit, cluster.cluster=cloud"),
        ("submitit", {"cluster": "local", "minutes": 3}, "submitit.*minutes"),
    ],
)
def test_options_that_a_launcher_does_not_take_are_refused(tmp_path, name, cluster, message):
    with pytest.raises(ValueError, match=message):
        list(run_jobs(counting(tmp_path, 1), 1, Launching(launcher=name, cluster=cluster)))


def test_no_worker_at_all_is_refused(tmp_path):
    with pytest.raises(ValueError, match="workers=0: must be 1 at least"):
        list(run_jobs(counting(tmp_path, 1), 0))


def double(number: int) -> int:
    """Twice the number."""
    return 2 * number


@pytest.mark.parametrize("name", ELSEWHERE)
def test_functions_run_wherever_scripts_do(tmp_path, no_cluster, name):
    calls = {f"call_{n}": (n,) for n in range(3)}
    found = results(double, calls, tmp_path / "calls", 2, launching(name))
    assert sorted(found) == [0, 2, 4]
