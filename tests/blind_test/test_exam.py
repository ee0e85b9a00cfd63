"""The exam, with a tool that does what its question says."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from buggy_rl.blind_test.exam import Examiner

TOOL = """
import os, pathlib, sys, time
question, output = sys.argv[1], pathlib.Path(sys.argv[2].removeprefix("output="))
do = pathlib.Path(question).read_text().strip()
with open(output / "asked", "a") as asked:
    asked.write("x")
(output / "pid").write_text(str(os.getpid()))
if do == "crash":
    sys.exit("the wheel came off")
if do != "answer":
    time.sleep(float(do))
(output / "diagnosis.json").write_text("{}")
(output / "saw").write_text(" ".join(sorted(p.name for p in pathlib.Path(".").rglob("*"))))
"""


@pytest.fixture
def tool(tmp_path) -> Path:
    file = tmp_path / "tool.py"
    file.write_text(TOOL)
    return file


def asked(tmp_path, *questions: str) -> list[tuple[Path, Path]]:
    folders = []
    for number, text in enumerate(questions):
        seen = tmp_path / "cases" / str(number)
        seen.mkdir(parents=True)
        (seen / "question.yaml").write_text(text)
        folders.append((seen, tmp_path / "answers" / str(number)))
    return folders


def read(folder: Path) -> dict:
    return json.loads((folder / "outcome.json").read_text())


def test_the_tool_runs_in_the_folder_of_what_may_be_seen(tool, tmp_path):
    folders = asked(tmp_path, "answer")
    assert [o["status"] for o in Examiner(tool).run(folders)] == ["answered"]
    assert (folders[0][1] / "saw").read_text() == "question.yaml"


def test_a_crash_is_an_outcome_and_does_not_stop_the_others(tool, tmp_path):
    folders = asked(tmp_path, "crash", "answer")
    outcomes = list(Examiner(tool, workers=1).run(folders))
    assert sorted(o["status"] for o in outcomes) == ["answered", "crashed"]
    assert "the wheel came off" in read(folders[0][1])["last_words"]


def test_a_case_that_takes_too_long_is_ended(tool, tmp_path):
    folders = asked(tmp_path, "60")
    begun = time.monotonic()
    assert [o["status"] for o in Examiner(tool, limit=0.8).run(folders)] == ["timed out"]
    assert time.monotonic() - begun < 20


def test_what_is_answered_is_not_asked_again(tool, tmp_path):
    folders = asked(tmp_path, "answer", "crash")
    assert len(list(Examiner(tool).run(folders))) == 2
    assert list(Examiner(tool).run(folders)) == []
    assert all((said / "asked").read_text() == "x" for _, said in folders)


EXAM = """
import signal
import sys
from pathlib import Path
from buggy_rl.config import run
from buggy_rl.blind_test.exam import Examiner
tool, root = Path(sys.argv[1]), Path(sys.argv[2])
folders = [(root / "cases" / str(n), root / "answers" / str(n)) for n in range(3)]
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored below a shell's background
def main():
    for outcome in Examiner(tool, workers=1).run(folders):
        print(outcome["status"], flush=True)
run(main)
"""


@pytest.mark.parametrize("blow", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_after_a_kill_the_exam_goes_on_where_it_stopped(tool, tmp_path, blow):
    folders = asked(tmp_path, "answer", "6", "answer")
    command = [sys.executable, "-c", EXAM, str(tool), str(tmp_path)]
    exam = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL)
    assert exam.stdout is not None
    assert exam.stdout.readline() == "answered\n"
    pid = folders[1][1] / "pid"
    while not (pid.exists() and pid.read_text()):
        time.sleep(0.02)
    os.kill(exam.pid, blow)
    assert exam.wait(20) != 0
    if blow != signal.SIGKILL:  # of which it hears nothing
        with pytest.raises(ProcessLookupError):  # the tool has ended with the exam
            os.kill(int(pid.read_text()), 0)
    assert [(said / "outcome.json").exists() for _, said in folders] == [True, False, False]

    (folders[1][0] / "question.yaml").write_text("answer")
    assert [o["status"] for o in Examiner(tool).run(folders)] == ["answered", "answered"]
    assert (folders[0][1] / "asked").read_text() == "x"
    assert (folders[1][1] / "asked").read_text() == "xx"
