"""What ends a drive: signals, and the end of the process that started this one."""

import ctypes
import os
import signal
import sys
from types import FrameType, TracebackType
from typing import Any, Dict, Optional, Sequence

ALWAYS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
IF_FREE = (
    *("SIGUSR1", "SIGUSR2", "SIGALRM", "SIGVTALRM", "SIGPROF"),
    *("SIGXCPU", "SIGPOLL", "SIGPWR", "SIGSTKFLT"),
)
"""Signals that end a process too, unless a library of it uses them."""


class StopSignals:
    """Catches the signals that ask a process to end, so that it ends between two steps.

    Args:
        ignored: Signals that are for another process.
    """

    def __init__(self, ignored: Sequence[signal.Signals] = ()) -> None:
        self.caught = ""
        """The signal's name; empty before one came."""
        self._ignored = ignored
        self._before: Dict[signal.Signals, Any] = {}

    def __enter__(self) -> "StopSignals":
        """Catches signals from here on."""
        for name in (*ALWAYS, *IF_FREE):
            number = getattr(signal, name, None)  # not every system has all
            if number is None:
                continue
            if name in ALWAYS or signal.getsignal(number) == signal.SIG_DFL:
                handler = signal.SIG_IGN if number in self._ignored else self._catch
                self._before[number] = signal.signal(number, handler)
        return self

    def __exit__(
        self,
        kind: Optional[type],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """Puts the earlier handlers back."""
        for number, handler in self._before.items():
            if handler is not None:  # None: a library's own, which Python cannot put back
                signal.signal(number, handler)

    def _catch(self, number: int, frame: Optional[FrameType]) -> None:
        self.caught = signal.Signals(number).name


PR_SET_PDEATHSIG = 1  # of linux/prctl.h


class Parent:
    """The starter of this process, by the number that it gave of itself.

    Its death shows in two ways: on Linux the kernel sends a signal, which reaches this process even
    while it waits for something else, and everywhere this process gets another parent.

    Args:
        number: Process id of the parent; 0 for none that matters.
        signals: Whether to ask the kernel for SIGTERM at its death. The kernel takes the end of the
            *thread* that made this process for it: only for children of a main thread.
    """

    def __init__(self, number: int, signals: bool = True) -> None:
        self._number = number
        if number and signals and sys.platform.startswith("linux"):
            _signal_at_death(signal.SIGTERM)

    @property
    def gone(self) -> bool:
        """Whether the starter has ended."""
        return bool(self._number) and os.getppid() != self._number


def _signal_at_death(number: int) -> None:
    """Asks for a signal at the parent's end; without `prctl` its change alone tells."""
    try:
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, int(number), 0, 0, 0)
    except (OSError, AttributeError):
        return
