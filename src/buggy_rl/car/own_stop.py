"""Neutral by the loop's own hand where the watchdog cannot, until the board took it."""

import contextlib
import subprocess
import time
from typing import Any, Callable, Mapping, Optional, Tuple

from buggy_rl.car.board_lock import hold, release
from buggy_rl.car.clock import Clock
from buggy_rl.car.guard import Guard, GuardTimes
from buggy_rl.car.interfaces import ACTUATORS, Actuator, Command, device_class
from buggy_rl.car.messages import REFUSED

LINGER = 0.5  # [s] that neutral is written for after the other process died: a board may miss one
GIVE_UP = 60.0  # [s] after which a board that takes no command is left to its hardware failsafe

Tell = Callable[[Tuple[Command, int]], None]


def keep_neutral(guard: Guard, clock: Clock, linger: float, tell: Tell, sequence: int = 0) -> int:
    """Writes neutral until the board took it, and on for `linger` [s].

    Args:
        guard: Of the board.
        clock: The time.
        linger: Since the begin [s].
        tell: Hears of each attempt.
        sequence: Of the command that asked for it; 0 if none did.

    Returns:
        `TAKEN` or `READ_BACK`; `REFUSED` if it was given up, after `GIVE_UP`.
    """
    begin, best = clock.now(), REFUSED
    guard.silence(sequence)
    while True:
        done = guard.act(clock.now())
        if done is not None:
            tell(done)
            best = max(best, done[1])
        since = clock.now() - begin
        if best and since >= linger:
            return best
        if since > GIVE_UP or guard.gone:
            return best
        clock.sleep(guard.wait(clock.now()))


LONGEST_END = 0.02  # [s] that a killed watchdog has to let go of a device which only one can open
RETRY = 0.003  # [s] after a device that could not be opened
GIVE_UP_AFTER = 60.0  # [s] likewise


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
        end = time.monotonic() + GIVE_UP_AFTER
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
