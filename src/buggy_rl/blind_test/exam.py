"""The exam: the diagnosis as a process of its own, which is given what may be seen, no more."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

TAIL = 2000  # characters of a process's last words that are kept


class Examiner:
    """Asks the tool case by case, several at a time.

    Args:
        script: The tool.
        limit: Seconds that it may take for a case.
        workers: Cases at a time.
    """

    def __init__(self, script: Path, limit: float = 3600.0, workers: int = 2) -> None:
        self.script, self.limit, self.workers = script.resolve(), limit, workers
        self._running: set[subprocess.Popen] = set()
        self._stopped = False

    def run(self, asked: Sequence[tuple[Path, Path]]) -> Iterator[dict]:
        """Asks what is not answered yet; yields each outcome as it comes.

        A crash, or a case that takes too long, is an outcome like any other. Stopped by Ctrl-C it
        ends what runs, and a case that was not finished is asked again the next time.

        Args:
            asked: Folder of what may be seen and folder for the answer, of each case.
        """
        open_ = [(seen, said) for seen, said in asked if not finished(said)]
        pool = ThreadPoolExecutor(self.workers)
        try:
            for future in as_completed([pool.submit(self.ask, *folders) for folders in open_]):
                come = future.result()
                if come is not None:
                    yield come
        finally:
            self._stopped = True
            pool.shutdown(wait=False, cancel_futures=True)
            for process in list(self._running):
                end(process)
            pool.shutdown()

    def ask(self, seen: Path, said: Path) -> dict | None:
        """One case: its outcome, or None when stopped."""
        if self._stopped:
            return None
        said.mkdir(parents=True, exist_ok=True)
        begun = time.monotonic()
        command = [sys.executable, str(self.script), "question.yaml", f"output={said.resolve()}"]
        with open(said / "log.txt", "w") as log:
            process = subprocess.Popen(
                command,
                cwd=seen,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | {"OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "PASSIVE"},
            )
            self._running.add(process)
            try:
                process.wait(self.limit)
                status = "answered" if process.returncode == 0 else "crashed"
            except subprocess.TimeoutExpired:
                status = "timed out"
                end(process)
            finally:
                self._running.discard(process)
        if self._stopped:
            return None
        come = {
            "status": status,
            "seconds": round(time.monotonic() - begun, 1),
            "last_words": (said / "log.txt").read_text(errors="replace")[-TAIL:],
        }
        write_json(outcome_file(said), come)
        return come


def outcome_file(said: Path) -> Path:
    """File that tells how asking ended, beside the answer."""
    return said / "outcome.json"


def finished(said: Path) -> bool:
    """Whether a case has an outcome."""
    return outcome_file(said).exists()


def write_json(file: Path, content: object) -> None:
    """Writes a file that is there as a whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    partial = file.with_suffix(".partial")
    partial.write_text(json.dumps(content, indent=1) + "\n")
    partial.replace(file)


def end(process: subprocess.Popen, how: signal.Signals = signal.SIGKILL) -> None:
    """Ends a process, which leads a session of its own, with all that it started."""
    try:
        os.killpg(process.pid, how)
    except ProcessLookupError:
        return  # it has ended by itself
    process.wait()
