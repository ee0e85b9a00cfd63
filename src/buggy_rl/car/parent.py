"""The process that started this one: when it is gone, this one ends too."""

import ctypes
import os
import signal
import sys

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
        """It has ended."""
        return bool(self._number) and os.getppid() != self._number


def _signal_at_death(number: int) -> None:
    """Without the C library's `prctl` the change of the parent alone tells."""
    try:
        ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, int(number), 0, 0, 0)
    except (OSError, AttributeError):
        return
