"""Standard output and error whose reader is asleep or gone: who writes goes on."""

import subprocess
import sys
import time

import pytest

TALKER = """
import os, sys, time
from buggy_rl.car.output import UnblockedOutput
begin = time.monotonic()
with UnblockedOutput():
    print("first", flush=True)
    for _ in range(100):
        print("x" * 10_000)
        sys.stderr.write("x" * 10_000)
        try:
            os.write(2, b"x" * 10_000)
        except BlockingIOError:
            pass
    open(sys.argv[1], "w").write(repr(time.monotonic() - begin))
"""


def talker(file, **streams):
    return subprocess.Popen([sys.executable, "-c", TALKER, str(file)], **streams)


def test_a_full_pipe_holds_up_nobody(tmp_path):
    file = tmp_path / "seconds"
    process = talker(file, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.wait(20) == 0
    assert float(file.read_text()) < 2.0
    assert process.stdout.read().startswith(b"first")
    process.stdout.close()
    process.stderr.close()


def test_a_closed_pipe_fails_nobody(tmp_path):
    file = tmp_path / "seconds"
    process = talker(file, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    process.stderr.close()
    assert process.wait(20) == 0
    assert file.exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /dev/full")
def test_a_full_disk_fails_nobody(tmp_path):
    file = tmp_path / "seconds"
    with open("/dev/full", "w") as full:
        assert talker(file, stdout=full, stderr=full).wait(20) == 0
    assert file.exists()


def test_what_is_written_arrives_where_somebody_reads():
    program = "from buggy_rl.car.output import UnblockedOutput as U\nimport os, sys\nwith U():\n"
    program += "    print('one'); os.write(1, b'two\\n'); sys.stderr.write('three')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (sorted(done.stdout.split()), done.stderr) == (["one", "two"], "three")


def test_a_program_that_raises_says_so_at_the_end():
    program = "from buggy_rl.car.output import UnblockedOutput as U\nwith U():\n    1 / 0"
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert "ZeroDivisionError" in done.stderr
    assert time.monotonic() - begin < 10
