"""Signals that end a drive."""

import signal
from types import FrameType, TracebackType
from typing import Any, Dict, Optional, Sequence

ALWAYS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
IF_FREE = (
    *("SIGUSR1", "SIGUSR2", "SIGALRM", "SIGVTALRM", "SIGPROF"),
    *("SIGXCPU", "SIGPOLL", "SIGPWR", "SIGSTKFLT"),
)
"""They end a process too, unless a library of it uses them."""


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
        """From here on signals are caught."""
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
