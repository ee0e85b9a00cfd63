"""Neutral by the loop's own hand: where the watchdog is gone, silent, or cannot reach the board."""

import contextlib
import subprocess
import time
from typing import Any, Mapping, Optional

from buggy_rl.car.board_lock import hold, release
from buggy_rl.car.clock import Clock
from buggy_rl.car.devices import ACTUATORS, device_class
from buggy_rl.car.guard import Guard, GuardTimes
from buggy_rl.car.interfaces import Actuator, Command
from buggy_rl.car.leaving import LINGER, keep_neutral
from buggy_rl.car.messages import REFUSED

LONGEST_END = 0.02  # [s] that a killed watchdog has to let go of a device which only one can open
RETRY = 0.003  # [s] after a device that could not be opened
GIVE_UP = 60.0  # [s] likewise


class OwnStop:
    """The loop's own way to the board. It writes neutral and nothing else.

    Args:
        about: `kind` and settings of the actuator; the watchdog has it open.
        clock: The loop's.
        at_rest: Neutral.

    Raises:
        OSError: The device cannot be opened a second time, though its driver says that it can.
    """

    def __init__(self, about: Mapping[str, Any], clock: Clock, at_rest: Command) -> None:
        self._kind, self._settings = device_class(ACTUATORS, about, "actuator")
        self._clock, self._at_rest = clock, at_rest
        self._lock = self._kind.board(self._settings)
        hold(self._lock)
        self._board: Optional[Actuator] = self._kind.second(self._settings)

    @property
    def shared(self) -> bool:
        """Both processes have the device open, so that the loop need not end the watchdog."""
        return self._board is not None

    def assist(self) -> None:
        """Writes neutral once, beside a watchdog that is late or reports that it cannot."""
        if self._board is not None:
            with contextlib.suppress(Exception):  # the next step tries again
                self._board.write(*self._at_rest)

    def end(self, watchdog: "subprocess.Popen[bytes]") -> None:
        """Ends the watchdog, so that it writes no more; neutral is written once at once."""
        watchdog.kill()  # one that is stopped by SIGSTOP too
        self.assist()
        end = time.monotonic() + LONGEST_END
        while watchdog.poll() is None and time.monotonic() < end:
            time.sleep(0.0005)

    def stop(self) -> int:
        """Writes neutral until it is taken; what the watchdog wrote last is written over.

        Returns:
            `TAKEN`, `READ_BACK` or `REFUSED`.
        """
        board = self._opened()
        if board is None:
            return REFUSED
        guard = Guard(board, GuardTimes(), self._clock.now(), self._at_rest)
        return keep_neutral(guard, self._clock, LINGER, lambda done: None)

    def _opened(self) -> Optional[Actuator]:
        """The board, also one that only one process can open."""
        end = time.monotonic() + GIVE_UP
        while self._board is None and time.monotonic() < end:
            try:
                self._board = self._kind.from_dict(self._settings)
            except OSError:
                time.sleep(RETRY)
        return self._board

    def close(self) -> None:
        """Lets go of the device."""
        if self._board is not None:
            self._board.close()
            self._board = None
        release(self._lock)
