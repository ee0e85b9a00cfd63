"""Signals that end a drive."""

import signal
from types import FrameType, TracebackType
from typing import Any, List, Optional

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopSignals:
    """Catches the signals that ask a process to end, so that the loop ends between two steps."""

    def __init__(self) -> None:
        self.caught = ""
        """The signal's name; empty before one came."""
        self._before: List[Any] = []

    def __enter__(self) -> "StopSignals":
        """From here on signals are caught."""
        self._before = [signal.signal(number, self._catch) for number in SIGNALS]
        return self

    def __exit__(
        self,
        kind: Optional[type],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """Puts the earlier handlers back."""
        for number, handler in zip(SIGNALS, self._before):
            signal.signal(number, handler)

    def _catch(self, number: int, frame: Optional[FrameType]) -> None:
        self.caught = signal.Signals(number).name
