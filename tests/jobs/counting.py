"""Jobs that count, keep a checkpoint, and are killed while they do."""

import hashlib
import os
import random
import signal
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from buggy_rl.jobs import Job

STEPS = 30
SCRIPT = """
import hashlib, os, pathlib, sys, time
told = dict(argument.split("=", 1) for argument in sys.argv[1:])
folder, seed = pathlib.Path(told["output"]), told["seed"]
checkpoint = folder / "checkpoint"
step, value = 0, seed
if "resume" in told:
    step, value = checkpoint.read_text().split()
(folder / "pid").write_text(str(os.getpid()))
for step in range(int(step), int(told["steps"])):
    value = hashlib.sha256(f"{value} {step}".encode()).hexdigest()
    time.sleep(float(told["pause"]))
    (folder / "partial").write_text(f"{step + 1} {value}")
    (folder / "partial").replace(checkpoint)
    with open(folder / "steps", "a") as steps:
        steps.write(f"{step}\\n")
(folder / "result").write_text(value)
"""


def counting(folder: Path, count: int, pause: float = 0.05) -> list[Job]:
    """Jobs whose result is known beforehand."""
    folder.mkdir(parents=True, exist_ok=True)
    script = folder / "count.py"
    script.write_text(SCRIPT)
    jobs = []
    for seed in range(count):
        own = folder / f"job_{seed}"
        options = (f"seed={seed}", f"steps={STEPS}", f"pause={pause}", f"output={own}")
        command = (str(script), *options)
        jobs.append(Job(f"job {seed}", own, command, checkpoint="checkpoint"))
    return jobs


def expected(seed: int) -> str:
    """What job number `seed` writes."""
    value = str(seed)
    for step in range(STEPS):
        value = hashlib.sha256(f"{value} {step}".encode()).hexdigest()
    return value


def right(jobs: Sequence[Job]) -> list[bool]:
    """Whether each result is there and is the expected one."""
    files = [job.folder / "result" for job in jobs]
    return [f.exists() and f.read_text() == expected(seed) for seed, f in enumerate(files)]


def parent(pid: int) -> int:
    """Of a process; 0 where it has ended."""
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def command_of(pid: int) -> str:
    """Its command line; empty where it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


def mine(marker: str) -> list[str]:
    """Command lines of the processes that run now and name the marker."""
    pids = [int(p.name) for p in Path("/proc").iterdir() if p.name.isdigit()]
    found = {pid: command_of(pid) for pid in pids if pid != os.getpid()}
    return [command for command in found.values() if marker in command]


class Killer(threading.Thread):
    """Sends SIGKILL to a job, or to the worker that watches it, at random moments.

    Args:
        jobs: Of which one that runs is hit.
        kills: Times.
        above: Processes above the script that may be hit in its place: 1 for its worker.
        seed: Of moments and victims.
    """

    def __init__(self, jobs: Sequence[Job], kills: int, above: int = 0, seed: int = 0) -> None:
        super().__init__(daemon=True)
        self._jobs, self._left, self._above = jobs, kills, above
        self._random = random.Random(seed)
        self.hits: list[str] = []
        self.over = threading.Event()

    def run(self) -> None:
        while self._left and not self.over.is_set():
            time.sleep(self._random.uniform(0.1, 0.6))
            running = [job for job in self._jobs if not (job.folder / "result").exists()]
            if running and self._hit(self._random.choice(running)):
                self._left -= 1

    def _hit(self, job: Job) -> bool:
        try:
            pid = int((job.folder / "pid").read_text())
        except (OSError, ValueError):
            return False
        if str(job.folder) not in command_of(pid):
            return False  # it has ended, and its number is another's
        for _ in range(self._random.randint(0, self._above)):
            pid = parent(pid)
        if pid in (0, 1, os.getpid()):
            return False
        self.hits.append(command_of(pid))
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            return False
        return True
