"""Runs a script that cannot read some paths, nor can anything that it starts: by Linux's Landlock.

    python confined.py --hidden PATH ... --shown PATH ... -- script.py options...

Landlock forbids what no rule allows, and a rule holds for a folder with all below it. So on the way
down to what is hidden every other entry of each folder gets a rule, and what is shown within it
too. Names and sizes of files are seen everywhere; an importer lists folders. What is made later in
a folder on that way can be written and not read, so the folder of temporary files is made first.

The script is another process, which confines itself just before it begins: this one holds the
leash of a job and stays as it is. Only the standard library is used: the package may be hidden.

Source: Landlock: unprivileged access control, Linux userspace API documentation.
"""

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
from argparse import ArgumentParser
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system calls, the same on x86-64 and Arm
VERSION = 1  # flag of CREATE_RULESET: tells the ABI
PATH_BENEATH = 1  # type of a rule
READ_FILE, REFER = 1 << 2, 1 << 13  # rights: reading a file; moving it into another folder
REFER_SINCE = 2  # ABI; before, nothing can be moved into another folder
NO_NEW_PRIVILEGES = 38  # option of prctl, without which a process may not confine itself

LIBC = ctypes.CDLL(None, use_errno=True)
LIBC.syscall.restype = ctypes.c_long


class Ruleset(ctypes.Structure):
    """The kernel's `landlock_ruleset_attr`, as far as it is needed."""

    _fields_ = (("handled_access_fs", ctypes.c_uint64),)


class PathBeneath(ctypes.Structure):
    """The kernel's `landlock_path_beneath_attr`."""

    _pack_ = 1
    _fields_ = (("allowed_access", ctypes.c_uint64), ("parent_fd", ctypes.c_int32))


def missing() -> str:
    """Why no process can be confined here; empty where one can."""
    if sys.platform != "linux":
        return f"{sys.platform} has no Landlock"
    try:
        return "" if abi() else "this kernel has no Landlock"
    except OSError as error:
        return f"this kernel has no Landlock, or it may not be used here ({error.strerror})"


def abi() -> int:
    """Version of the kernel's Landlock, from 1.

    Raises:
        OSError: It has none, or a container forbids it.
    """
    return _call(CREATE_RULESET, None, 0, VERSION)


def readable(hidden: Iterable[Path], shown: Iterable[Path] = ()) -> Iterator[Path]:
    """Files and folders that together hold all that may be read; as few as there can be.

    Args:
        hidden: What may not be read, with all below; whether it is there yet or not.
        shown: What may be read within it.
    """
    every = {path.resolve() for path in hidden}
    outermost = {path for path in every if every.isdisjoint(path.parents)}
    ways = {folder for path in outermost for folder in path.parents}
    for folder in ways:
        # Where a folder cannot be listed, nothing else in it was to be read.
        with suppress(FileNotFoundError, PermissionError), os.scandir(folder) as entries:
            # A link is followed to its target, which has or has not a rule of its own.
            beside = (Path(entry.path) for entry in entries if not entry.is_symlink())
            yield from (path for path in beside if path not in ways | outermost)
    yield from (path.resolve() for path in shown)


def made_ruleset(paths: Iterable[Path]) -> int:
    """File descriptor of a ruleset by which files are read at or below some paths alone.

    Raises:
        OSError: There is no Landlock.
    """
    moves = REFER if abi() >= REFER_SINCE else 0
    attributes = Ruleset(READ_FILE | moves)
    ruleset = _call(CREATE_RULESET, ctypes.byref(attributes), ctypes.sizeof(attributes), 0)
    if moves:  # everywhere; the kernel itself refuses a move to where more could be read
        _allow(ruleset, Path("/"), moves)
    for path in paths:
        with suppress(FileNotFoundError):  # gone since its folder was listed
            _allow(ruleset, path, READ_FILE)
    return ruleset


def restrict(ruleset: int) -> None:
    """Confines this thread, with all that it starts from now on, for good."""
    LIBC.prctl(*map(ctypes.c_long, (NO_NEW_PRIVILEGES, 1, 0, 0, 0)))
    _call(RESTRICT_SELF, ruleset, 0)


def run_confined(command: Sequence[str], hidden: Sequence[Path], shown: Sequence[Path]) -> int:
    """Runs a script with its options; its exit code, the negative of a signal that ended it."""
    signal.signal(signal.SIGTERM, lambda *_: None)  # sent to both: the script ends first
    with tempfile.TemporaryDirectory(prefix="confined_") as temporary:
        ruleset = made_ruleset(readable(hidden, [*shown, Path(temporary)]))
        return subprocess.run(
            [sys.executable, *command],
            env=os.environ | {"TMPDIR": temporary},
            preexec_fn=partial(restrict, ruleset),
        ).returncode


def main() -> None:
    """Runs what the command line says, and ends as it does."""
    parser = ArgumentParser(description="Runs a script that cannot read some paths.")
    parser.add_argument("--hidden", nargs="+", type=Path, required=True)
    parser.add_argument("--shown", nargs="*", type=Path, default=[])
    parser.add_argument("command", nargs="+")
    given = parser.parse_args()
    if why := missing():
        sys.exit(f"error: {why}: nothing can be hidden from {given.command[0]}")
    code = run_confined(given.command, given.hidden, given.shown)
    if code < 0:
        with suppress(OSError):  # SIGKILL cannot be handled
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    sys.exit(code)


def _allow(ruleset: int, path: Path, rights: int) -> None:
    parent = os.open(path, os.O_PATH | os.O_CLOEXEC)
    try:
        rule = PathBeneath(rights, parent)
        _call(ADD_RULE, ruleset, PATH_BENEATH, ctypes.byref(rule), 0)
    finally:
        os.close(parent)


def _call(number: int, *arguments) -> int:
    """A system call's result; whole registers are written, so integers are long."""
    whole = [ctypes.c_long(a) if isinstance(a, int) else a for a in (number, *arguments)]
    result = LIBC.syscall(*whole)
    if result < 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return result


if __name__ == "__main__":
    main()
