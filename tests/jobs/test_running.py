"""Jobs that are run once, with scripts that do what they are told."""

import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from buggy_rl.jobs import Job, Running, cores, read_outcome, results, run_jobs

ROOT = Path(__file__).parents[2]
POLL = 0.02
SCRIPT = """
import os, subprocess, sys, time
from pathlib import Path
told = dict(argument.split("=", 1) for argument in sys.argv[1:])
folder = Path(told["output"])
with open(folder / "calls", "a") as calls:
    calls.write("resumed " if "resume" in told else "begun ")
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
(folder / "partial").write_text(f"{os.getpid()} {child.pid}")
(folder / "partial").rename(folder / "pids")
(folder / "checkpoint").touch()
if told["do"] == "fail":
    child.kill()
    sys.exit("no root found")
time.sleep(float(told["do"]))
child.kill()
(folder / "saw").write_text(" ".join(sorted(p.name for p in Path(".").rglob("*"))))
"""


@pytest.fixture
def job(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)

    def make(name: str, do: str = "0", **options) -> Job:
        folder = tmp_path / name
        command = (str(script), f"do={do}", f"output={folder}")
        return Job(name, folder, command, **{"checkpoint": "checkpoint", **options})

    return make


def calls(job: Job) -> str:
    return (job.folder / "calls").read_text()


def pids(job: Job) -> list[int]:
    while not (job.folder / "pids").exists():
        time.sleep(POLL)
    return [int(pid) for pid in (job.folder / "pids").read_text().split()]


def alive(pid: int, patience: float = 5.0) -> bool:
    """Whether a process runs, and does not end by itself: a signal takes a moment to arrive."""
    for _ in range(round(patience / POLL)):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            return False
        if state == "Z":  # an orphan that nobody has waited for yet
            return False
        time.sleep(POLL)
    return True


def outcomes(jobs, workers=1):
    """(name, status) of the jobs that were run."""
    states = run_jobs(jobs, workers, poll=POLL)
    return [(state.job.name, state.outcome.status) for state in states if state.outcome]


def test_what_is_done_is_not_done_again(job):
    jobs = [job("one"), job("two")]
    assert sorted(outcomes(jobs, 2)) == [("one", "done"), ("two", "done")]
    assert outcomes(jobs, 2) == []
    assert [calls(j) for j in jobs] == ["begun ", "begun "]


def test_a_job_that_fails_is_reported_at_the_end_and_resumed_from_its_checkpoint(job):
    bad, good = job("bad", "fail"), job("good")
    for _ in range(2):
        with pytest.raises(ValueError, match=r"1 of 2 failed\nbad: .*no root found"):
            outcomes([bad, good])
    assert (good.done, bad.done) == (True, False)
    assert calls(bad) == "begun resumed "
    assert calls(good) == "begun "


def test_a_failure_that_is_final_is_an_outcome_and_does_not_stop_the_others(job):
    jobs = [job("bad", "fail", final=True), job("good", final=True)]
    assert outcomes(jobs) == [("bad", "failed"), ("good", "done")]
    assert "no root found" in read_outcome(jobs[0].folder)["last_words"]
    assert outcomes(jobs) == []


def test_a_final_outcome_stands_whatever_the_command(job):
    assert len(outcomes([job("one", final=True)])) == 1
    assert outcomes([job("one", "0.1", final=True)]) == []


def test_a_job_that_takes_too_long_is_ended_with_its_children(job):
    slow = job("slow", "60", limit=1.5, final=True)
    assert outcomes([slow]) == [("slow", "timed out")]
    assert not any(alive(pid) for pid in pids(slow))


def test_a_job_runs_in_its_working_directory(job, tmp_path):
    (tmp_path / "inputs").mkdir()
    (tmp_path / "inputs" / "question.yaml").touch()
    one = job("one", cwd=tmp_path / "inputs")
    outcomes([one])
    assert (one.folder / "saw").read_text() == "question.yaml"


@pytest.mark.slow
def test_no_more_run_at_a_time_than_there_are_workers(job):
    jobs = [job(str(n), "0.3") for n in range(3)]
    shares = {}
    for state in run_jobs(jobs, 1, poll=POLL):
        shares.setdefault(state.job.name, []).append(state.share)
        assert len([j for j in jobs if (j.folder / "calls").exists() and not j.done]) <= 1
    assert [each.count(1.0) for each in shares.values()] == [1, 1, 1]


def test_a_stop_ends_what_runs_and_the_next_start_goes_on(job):
    slow = job("slow", "60")
    running = run_jobs([slow], 1, poll=POLL)
    next(running)
    started = pids(slow)
    running.close()
    assert not any(alive(pid) for pid in started)
    assert not slow.done
    with Running(1) as again:
        again.start(slow)
        while "resumed" not in calls(slow):
            time.sleep(POLL)


def test_a_folder_begun_with_another_command_is_refused(job):
    outcomes([job("one")])
    with pytest.raises(ValueError, match=r"was begun by .*do=0.*now wanted is .*do=0.1"):
        outcomes([job("one", "0.1")])


@pytest.mark.parametrize("do", ["0", "fail"])
def test_what_was_made_from_a_file_that_has_changed_is_refused(job, tmp_path, do):
    settings, same = tmp_path / "settings.yaml", tmp_path / "same.yaml"
    settings.write_text("discount: 0.98")
    same.write_text("")
    one = job("one", do, inputs=(str(settings), str(same)))
    try:
        outcomes([one])
    except ValueError:
        assert do == "fail"
    assert one.done == (do != "fail")
    settings.write_text("discount: 0.99")
    with pytest.raises(ValueError, match=rf"was begun before {settings} had changed"):
        outcomes([one])
    assert calls(one) == "begun "


def test_a_file_that_changes_while_a_script_runs_is_not_taken_for_what_it_read(job, tmp_path):
    settings = tmp_path / "settings.yaml"
    settings.write_text("discount: 0.98")
    one = job("one", "0.3", inputs=(str(settings),))
    running = run_jobs([one], 1, poll=POLL)
    next(running)
    settings.write_text("discount: 0.99")
    list(running)
    with pytest.raises(ValueError, match="had changed"):
        _ = one.done


INTERRUPTED = """
import signal, sys
from buggy_rl.core.config import run
from buggy_rl.jobs import Job, run_jobs
from pathlib import Path
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored below a shell's background
script, root = sys.argv[1], Path(sys.argv[2])
jobs = [
    Job(name, root / name, (script, f"do={do}", f"output={root / name}"), final=True)
    for name, do in (("one", 0), ("two", 60), ("three", 0))
]
def main():
    for state in run_jobs(jobs, 1, poll=0.02):
        if state.outcome:
            print(state.outcome.status, flush=True)
run(main)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "blow", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM, signal.SIGKILL]
)
def test_after_a_kill_the_jobs_go_on_where_they_stopped(job, tmp_path, blow):
    jobs = [job(name, final=True) for name in ("one", "two", "three")]
    command = [sys.executable, "-c", INTERRUPTED, jobs[0].command[0], str(tmp_path)]
    runner = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL)
    assert runner.stdout is not None
    assert runner.stdout.readline() == "done\n"
    started = pids(jobs[1])
    os.kill(runner.pid, blow)
    assert runner.wait(20) != 0
    # Of SIGKILL the runner hears nothing: its jobs notice that it has gone.
    assert not any(alive(pid) for pid in started)
    assert [j.done for j in jobs] == [True, False, False]
    assert len(outcomes(jobs)) == 2
    assert [calls(j) for j in jobs[:2]] == ["begun ", "begun resumed "]


KILLED = """
import sys
from pathlib import Path
from buggy_rl.core.config import run
from buggy_rl.jobs import results
from tests.jobs.test_running import linger
file = Path(sys.argv[1])
run(lambda: list(results(linger, {"one": (file,)}, file.parent / "calls", 1)))
"""


def linger(file: Path) -> None:
    """Writes its process id, and stays."""
    file.with_suffix(".partial").write_text(str(os.getpid()))
    file.with_suffix(".partial").replace(file)
    time.sleep(60)


@pytest.mark.parametrize("blow", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_a_parent_that_is_killed(tmp_path, blow):
    command = [sys.executable, "-c", KILLED, str(tmp_path / "pid")]
    parent = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
    while not (tmp_path / "pid").exists():
        time.sleep(0.05)
    parent.send_signal(blow)
    assert parent.wait(20) != 0
    assert not alive(int((tmp_path / "pid").read_text()))


def called(number: int) -> tuple[int, int, int]:
    """Its argument, its process and its parent."""
    return number, os.getpid(), os.getppid()


def test_results_of_a_function_come_from_processes_of_their_own(tmp_path):
    found = list(results(called, {"one": (1,), "two": (2,)}, tmp_path / "calls", 2))
    assert sorted(number for number, _, _ in found) == [1, 2]
    assert len({process for _, process, _ in found}) == 2
    assert {parent for _, _, parent in found} == {os.getpid()}
    assert not (tmp_path / "calls").exists()


def test_a_result_that_nobody_has_taken_is_not_computed_again(tmp_path):
    calls = tmp_path / "calls"
    first = next(results(called, {"one": (1,)}, calls, 1))  # stopped before it asks for the next
    assert list(results(called, {"one": (1,)}, calls, 1)) == [first]
    next(results(called, {"one": (1,)}, calls, 1))
    (other,) = results(called, {"one": (7,)}, calls, 1)  # another call in a folder left behind
    assert other[0] == 7


def test_what_lies_in_a_folder_that_was_handed_on_is_not_run(tmp_path):
    calls, ran = tmp_path / "calls", tmp_path / "ran"

    class Attack:
        def __reduce__(self):
            return os.system, (f"touch {ran}",)

    one = calls / "one"
    next(results(called, {"one": (1,)}, calls, 1))
    attack = pickle.dumps(Attack())
    for name in ("result.json", "result.pkl", "call.pkl"):
        (one / name).write_bytes(attack)
    with pytest.raises(ValueError, match=r"result\.json is no result of a call: take .* away"):
        list(results(called, {"one": (1,)}, calls, 1))
    (one / "result.json").unlink()
    (found,) = results(called, {"one": (1,)}, calls, 1)
    assert found[0] == 1
    assert not ran.exists()


def test_a_file_of_the_users_own_in_the_folder_of_a_call_is_left_there(tmp_path):
    calls = tmp_path / "calls"
    next(results(called, {"one": (1,)}, calls, 1))
    (calls / "one" / "notes.txt").write_text("kept")
    list(results(called, {"one": (7,)}, calls, 1))
    assert [file.name for file in (calls / "one").iterdir()] == ["notes.txt"]


def refuse(number: int) -> int:
    """Fails for odd numbers."""
    if number % 2:
        raise ArithmeticError(f"{number} is odd")
    return number


def test_a_call_that_fails_is_named_at_the_end_and_loses_no_other_result(tmp_path):
    found = []
    calls = {"a": (0,), "b": (1,), "c": (2,)}
    with pytest.raises(ValueError, match=r"1 of 3 failed\nb: failed: .*ArithmeticError: 1 is odd"):
        found.extend(results(refuse, calls, tmp_path / "calls", 1))
    assert found == [0, 2]
    assert "is odd" in (tmp_path / "calls" / "b" / "log.txt").read_text()


def test_jobs_that_share_a_machine_share_its_cores(monkeypatch, tmp_path):
    monkeypatch.delenv("BUGGY_RL_CORES", raising=False)
    own = len(os.sched_getaffinity(0))
    assert cores() == own
    assert list(results(cores, {"a": ()}, tmp_path, 1)) == [own]
    assert list(results(cores, {"a": (), "b": ()}, tmp_path, own)) == [1, 1]
    monkeypatch.setenv("BUGGY_RL_CORES", "0")
    with pytest.raises(ValueError, match="BUGGY_RL_CORES=0: must be"):
        cores()
