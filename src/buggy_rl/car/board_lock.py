"""An exclusive lock on a board: two programs cannot command one car.

The loop takes the lock and hands it to its watchdog, which keeps it when the loop is killed. Both
are of one runtime and command one board; any other process is refused until both are gone.
"""

import errno
import fcntl
import hashlib
import os
import re
import tempfile
import time
from typing import Dict, List

FOLDER = "/run/lock"  # of locks on devices, by the Filesystem Hierarchy Standard
PATIENCE = 1.5  # [s] a watchdog whose loop was killed writes neutral for 0.5 s more
_held: Dict[str, List[int]] = {}  # file -> descriptor, and how many in this process hold it


def lock_file(board: str) -> str:
    """The lock of a board, by what it is called on this computer, e.g. `i2c-1-0x40`."""
    folder = FOLDER if os.access(FOLDER, os.W_OK) else tempfile.gettempdir()
    short = re.sub(r"[^A-Za-z0-9.-]+", "_", board)[:40]
    return os.path.join(
        folder, f"buggy_rl_{short}_{hashlib.sha256(board.encode()).hexdigest()[:12]}.lock"
    )


def hold(file: str) -> int:
    """Takes a lock, which a process takes once for all that it has; returns its descriptor.

    Args:
        file: As of `lock_file`; empty where there is nothing to lock, which gives -1.

    Raises:
        OSError: Another program holds it.
    """
    if not file:
        return -1
    if file not in _held:
        _held[file] = [_locked(file), 0]
    _held[file][1] += 1
    return _held[file][0]


def inherit(file: str, descriptor: int) -> None:
    """Keeps a lock that the process which started this one holds, to the end of this process."""
    if file:
        _held[file] = [descriptor, 1]


def release(file: str) -> None:
    """Lets go of what `hold` took; the lock is free when all in all processes have."""
    if file in _held:
        _held[file][1] -= 1
        if not _held[file][1]:
            os.close(_held.pop(file)[0])


def _locked(file: str) -> int:
    """Waits for a program that is just ending, then refuses."""
    descriptor, end = _opened(file), time.monotonic() + PATIENCE
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
        except OSError as error:
            if error.errno not in (errno.EWOULDBLOCK, errno.EACCES) or time.monotonic() > end:
                os.close(descriptor)
                raise OSError(
                    f"another program commands this board (it holds {file}): end it first; "
                    f"`fuser {file}` names it"
                ) from None
        time.sleep(0.02)


def _opened(file: str) -> int:
    """Opened for reading, which is enough for a lock: another user may have made the file."""
    try:
        return os.open(file, os.O_RDONLY)
    except FileNotFoundError:
        return os.open(file, os.O_RDONLY | os.O_CREAT, 0o644)
