"""Runs a script in this process, alone in its folder, until the process that started it ends.

    python leash.py LOCK script.py options...
    python leash.py LOCK -m package.module options...

Standard input is a pipe to the starter. When it closes, however the starter ended, this process
group is killed: no job outlives the worker that watches it. LOCK is held while the script runs, so
that a job which is started again never runs twice at a time. Only the standard library is used.
"""

import fcntl
import os
import runpy
import signal
import sys
import threading
import time

PATIENCE = 15.0  # [s] that a job killed just now has to let go of its folder; SIGKILL takes ms
BUSY = 75  # exit code: EX_TEMPFAIL of sysexits.h


def main() -> None:
    """Holds the lock and runs the script as if it had been called by its own command."""
    threading.Thread(target=_follow, args=(_starter(),), daemon=True).start()
    hold_leash(sys.argv[1])
    sys.argv = sys.argv[2:]
    if sys.argv[0] == "-m":
        sys.argv = sys.argv[1:]
        sys.path[0] = os.getcwd()
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    else:
        sys.path[0] = os.path.dirname(os.path.abspath(sys.argv[0]))
        runpy.run_path(sys.argv[0], run_name="__main__")


def _starter() -> int:
    """Moves the pipe off standard input, which the script and its children find empty."""
    pipe = os.dup(0)
    empty = os.open(os.devnull, os.O_RDONLY)
    os.dup2(empty, 0)
    os.close(empty)
    return pipe


def _follow(pipe: int) -> None:
    while os.read(pipe, 1):
        continue
    os.killpg(0, signal.SIGKILL)


def hold_leash(file: str) -> None:
    """Takes the lock, which this process keeps to its end.

    Raises:
        SystemExit: Another process holds it after `PATIENCE` seconds.
    """
    lock = os.open(file, os.O_CREAT | os.O_RDWR)
    until = time.monotonic() + PATIENCE
    while True:
        try:
            return fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if time.monotonic() > until:
                print(
                    f"{os.path.dirname(file)}: another process works on this job; end it, or wait "
                    "for it, then start again",
                    file=sys.stderr,
                )
                sys.exit(BUSY)
            time.sleep(0.05)


if __name__ == "__main__":
    main()
