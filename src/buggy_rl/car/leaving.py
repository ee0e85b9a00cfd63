"""The last thing that is written to a board: neutral, until the board took it."""

from typing import Callable, Tuple

from buggy_rl.car.clock import Clock
from buggy_rl.car.guard import Guard
from buggy_rl.car.interfaces import Command
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
