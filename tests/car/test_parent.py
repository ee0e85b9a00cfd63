"""A process that ends with the one that started it, however that ends."""

import os
import signal
import subprocess
import sys
import time

import pytest

from buggy_rl.car.stopping import Parent

CHILD = """
import sys, time
from buggy_rl.car.stopping import Parent
parent = Parent(int(sys.argv[1]), sys.argv[2] == "1")
print("ready", flush=True)
while not (sys.argv[2] == "0" and parent.gone):
    time.sleep(0.01 if sys.argv[2] == "0" else 60)
"""
STARTER = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", sys.argv[1], str(os.getpid()), sys.argv[2]],
                         stdout=subprocess.PIPE, start_new_session=True)
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(60)
"""


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as stream:
            return stream.read().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("by", ["1", "0"], ids=["by the kernel's signal", "by looking"])
def test_a_killed_starter_leaves_nothing_behind(by):
    command = [sys.executable, "-c", STARTER, CHILD, by]
    starter = subprocess.Popen(command, stdout=subprocess.PIPE)
    child = int(starter.stdout.readline())
    assert alive(child)
    starter.kill()
    starter.wait()
    starter.stdout.close()
    end = time.monotonic() + 5
    while alive(child):
        assert time.monotonic() < end, "it lives on"
        time.sleep(0.01)


def test_a_parent_that_lives_is_not_gone():
    assert not Parent(os.getppid(), signals=False).gone
    assert not Parent(0).gone
    assert Parent(os.getpid(), signals=False).gone  # of another process


def test_no_signal_is_asked_for_without_a_parent():
    before = signal.getsignal(signal.SIGTERM)
    Parent(0)
    assert signal.getsignal(signal.SIGTERM) == before
