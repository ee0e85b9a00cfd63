"""A program that is killed leaves no simulated car and no runtime behind."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,  # PyTorch is imported three times
    pytest.mark.timeout(180),
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc"),
]
ROOT = Path(__file__).parents[2]
CAR = """
import sys, threading, time
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.launcher import SimulatedCar
def start():
    car = SimulatedCar(SimulatedCarConfig(simulator="kinematic"))
    print(car._process.pid, flush=True)
    time.sleep(100)
start() if sys.argv[1] == "main" else threading.Thread(target=start).start()
"""


def parents():
    """Process id -> its parent's and its command line, of all that live."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state, parent = (folder / "stat").read_text().rsplit(")", 1)[1].split()[:2]
            command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:
            continue  # it ended meanwhile
        if state != "Z":
            found[int(folder.name)] = int(parent), command
    return found


def gone_within(pids, seconds):
    """The processes of these that are still there after a time [s]."""
    end = time.monotonic() + seconds
    while (left := set(pids) & set(parents())) and time.monotonic() < end:
        time.sleep(0.05)
    return left


@pytest.mark.parametrize("thread", ["main", "another"])
def test_a_killed_starter_leaves_no_simulated_car(thread):
    starter = subprocess.Popen([sys.executable, "-c", CAR, thread], stdout=subprocess.PIPE)
    server = int(starter.stdout.readline())
    starter.kill()
    starter.wait()
    starter.stdout.close()
    assert not gone_within([server], 10)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
def test_a_drive_whose_script_gets_a_signal_leaves_nobody(tmp_path, number):
    command = [sys.executable, "scripts/drive.py", "car=simulated", "seconds=60"]
    options = ["simulated.simulator=kinematic", f"output={tmp_path}"]
    script = subprocess.Popen([*command, *options], cwd=ROOT, stdout=subprocess.PIPE)
    while script.stdout.readline().strip() != b"armed":
        assert script.poll() is None
    children = {pid for pid, (parent, _) in parents().items() if parent == script.pid}
    children |= {pid for pid, (parent, _) in parents().items() if parent in children}
    assert len(children) == 3  # simulated car, runtime, watchdog
    script.send_signal(number)
    script.wait(30)
    script.stdout.close()
    assert not gone_within(children, 10)
    if number != signal.SIGKILL:
        assert '"neutral_confirmed": true' in (tmp_path / "drive_00.json").read_text()
