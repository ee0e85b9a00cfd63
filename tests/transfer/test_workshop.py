"""Jobs side by side, with scripts that do what they are told."""

import json
import subprocess
import time

import pytest

from buggy_rl.transfer.job import Job
from buggy_rl.transfer.workshop import worked

SCRIPT = """
import sys, time
from pathlib import Path
told = dict(argument.split("=", 1) for argument in sys.argv[1:])
folder = Path(told["output"])
with open(folder / "calls", "a") as calls:
    calls.write("resumed " if "resume" in told else "begun ")
(folder / "checkpoint").touch()
if told["do"] == "fail":
    sys.exit("the wheel came off")
time.sleep(float(told["do"]))
"""
LOOK = 0.02


@pytest.fixture
def job(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)

    def make(name: str, do: str = "0", inputs: tuple[str, ...] = ()) -> Job:
        folder = tmp_path / name
        command = (str(script), f"do={do}", f"output={folder}")
        return Job(name, folder, command, inputs, checkpoint="checkpoint")

    return make


def calls(job: Job) -> str:
    return (job.folder / "calls").read_text()


def test_what_is_done_is_not_done_again(job):
    jobs = [job("one"), job("two")]
    assert sorted(j.name for j, share in worked(jobs, 2, LOOK) if share == 1) == ["one", "two"]
    assert list(worked(jobs, 2, LOOK)) == []
    assert [calls(j) for j in jobs] == ["begun ", "begun "]


def test_one_that_fails_is_told_at_the_end_and_tried_again_from_its_checkpoint(job):
    bad, good = job("bad", "fail"), job("good")
    for _ in range(2):
        with pytest.raises(ValueError, match="1 of 2 failed\nbad: the wheel came off"):
            list(worked([bad, good], 1, LOOK))
    assert (good.done, bad.done) == (True, False)
    assert calls(bad) == "begun resumed "
    assert calls(good) == "begun "


def test_no_more_run_at_a_time_than_there_are_workers(job):
    jobs = [job(str(n), "0.3") for n in range(3)]
    begun = time.monotonic()
    seen = {}
    for one, share in worked(jobs, 1, LOOK):
        seen.setdefault(one.name, []).append(share)
        running = [j for j in jobs if (j.folder / "calls").exists() and not j.done]
        assert len(running) <= 1
    assert time.monotonic() - begun > 0.9
    assert [shares.count(1.0) for shares in seen.values()] == [1, 1, 1]


def test_a_stop_ends_what_runs_and_the_next_start_goes_on(job):
    slow = job("slow", "60")
    running = worked([slow], 1, LOOK)
    next(running)
    while not (slow.folder / "checkpoint").exists():
        time.sleep(LOOK)
    running.close()
    listed = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert f"output={slow.folder}" not in listed
    assert not slow.done
    process = slow.start()
    while "resumed" not in calls(slow):
        time.sleep(LOOK)
    process.kill()
    process.wait()


def test_a_folder_begun_otherwise_is_not_taken_for_ones_own(job):
    list(worked([job("one")], 1, LOOK))
    with pytest.raises(ValueError, match=r"was begun by .*do=0.*now wanted is .*do=0.1"):
        list(worked([job("one", "0.1")], 1, LOOK))


@pytest.mark.parametrize("do", ["0", "fail"])
def test_what_was_made_from_a_file_that_has_changed_is_refused(job, tmp_path, do):
    settings, same = tmp_path / "settings.yaml", tmp_path / "same.yaml"
    settings.write_text("discount: 0.98")
    same.write_text("")
    one = job("one", do, (str(settings), str(same)))
    try:
        list(worked([one], 1, LOOK))
    except ValueError:
        assert do == "fail"
    assert one.done == (do != "fail")
    settings.write_text("discount: 0.99")
    with pytest.raises(ValueError, match=rf"was begun before {settings} had changed"):
        list(worked([one], 1, LOOK))
    assert calls(one) == "begun "


def test_a_file_that_changes_while_a_script_runs_is_not_taken_for_what_it_read(job, tmp_path):
    settings = tmp_path / "settings.yaml"
    settings.write_text("discount: 0.98")
    one = job("one", "0.3", (str(settings),))
    running = worked([one], 1, LOOK)
    next(running)
    settings.write_text("discount: 0.99")
    list(running)
    with pytest.raises(ValueError, match="had changed"):
        _ = one.done


def test_the_record_tells_the_command(job):
    one = job("one")
    list(worked([one], 1, LOOK))
    record = json.loads((one.folder / "job.json").read_text())
    assert record == {
        "command": ["script.py", *one.command[1:]],
        "inputs": {},
        "done": True,
    }
