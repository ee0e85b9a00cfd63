"""Standard output and error that never hold up or fail who writes: a full pipe loses the rest."""

import contextlib
import io
import os
import sys
import threading
from typing import Any, List

LARGEST = 65536  # bytes passed on at once
LAST_WORDS = 0.5  # [s] that a slow reader gets for what was written last


class NeverBlocking(io.RawIOBase):
    """Writes what the descriptor takes at once.

    Args:
        descriptor: Of the end of a pipe, which does not block.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor

    def writable(self) -> bool:
        """Says that the stream is for writing."""
        return True

    def fileno(self) -> int:
        """Descriptor of the stream."""
        return self._descriptor

    def write(self, data: Any) -> int:
        """Writes; what is not taken is lost."""
        with contextlib.suppress(OSError):
            os.write(self._descriptor, data)
        return len(data)


class UnblockedOutput:
    """Pipes as descriptors 1 and 2 for as long as it lasts, which a thread of its own empties.

    The terminal, file or pipe behind them may be full or closed: only that thread waits for it. All
    that writes is covered, Python's `sys.stderr`, `os.write(2, ...)` and a driver's C library.
    """

    def __enter__(self) -> "UnblockedOutput":
        """Redirects both descriptors: from here on nothing that is written waits."""
        self._before = sys.stdout, sys.stderr
        self._saved: List[int] = []
        self._threads: List[threading.Thread] = []
        for number, stream in ((1, sys.stdout), (2, sys.stderr)):
            with contextlib.suppress(OSError, ValueError, AttributeError):
                stream.flush()
            self._threads.append(self._redirected(number))
        sys.stdout, sys.stderr = (_text(number) for number in (1, 2))
        return self

    def _redirected(self, number: int) -> threading.Thread:
        source, sink = os.pipe()
        os.set_blocking(sink, False)
        try:
            self._saved.append(os.dup(number))
        except OSError:  # closed by who started this process
            self._saved.append(os.open(os.devnull, os.O_WRONLY))
        os.dup2(sink, number)
        os.close(sink)
        pump = threading.Thread(target=_pump, args=(source, self._saved[-1]), daemon=True)
        pump.start()
        return pump

    def __exit__(self, *error: Any) -> None:
        """What was written last is passed on, if somebody reads it."""
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = self._before
        for number, saved, pump in zip((1, 2), self._saved, self._threads):
            os.dup2(saved, number)  # closes the pipe, at whose end the thread ends
            pump.join(LAST_WORDS)


def _text(number: int) -> io.TextIOWrapper:
    stream = io.BufferedWriter(NeverBlocking(number))  # pyright: ignore[reportArgumentType]
    return io.TextIOWrapper(stream, "utf-8", "backslashreplace", line_buffering=True)


def _pump(source: int, sink: int) -> None:
    """Passes on all that comes; without a reader it is dropped."""
    while True:
        chunk = os.read(source, LARGEST)
        if not chunk:
            os.close(source)
            return
        with contextlib.suppress(OSError):
            while chunk:
                chunk = chunk[os.write(sink, chunk) :]
