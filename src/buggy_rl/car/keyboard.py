"""A keyboard in a terminal, over ssh too: a key counts as held while it repeats.

A terminal tells of keys pressed, not of keys released, and repeats a held key only after its delay
(250 to 660 ms). So nothing drives before a key repeats, and the car stops a moment after the last
repetition: letting go, a frozen terminal and a lost connection are the same.
"""

import os
import select
import sys
import time
from typing import Any, Callable, Dict, Mapping, Optional, Tuple

from buggy_rl.car.human import Controls, HumanConfig, HumanInput
from buggy_rl.car.interfaces import NO_DRIVE, Command, Pilot
from buggy_rl.car.settings import section

POLICY_KEY = "p"
NEUTRAL_KEYS = (" ", "s", "\x1b[B")  # space, s, arrow down
DRIVE_KEYS: Dict[str, Tuple[float, float]] = {  # a terminal repeats one key at a time
    "w": (1.0, 0.0),
    "\x1b[A": (1.0, 0.0),  # arrow up
    "q": (1.0, 1.0),
    "e": (1.0, -1.0),
    "a": (NO_DRIVE, 1.0),
    "\x1b[D": (NO_DRIVE, 1.0),  # arrow left
    "d": (NO_DRIVE, -1.0),
    "\x1b[C": (NO_DRIVE, -1.0),  # arrow right
}
REVERSE_KEY = "x"
HELP = "hold p: the policy drives; hold w, q, e, a, d: you drive; space: neutral"
HELP_BACK = "; hold x: you brake, then reverse"
RANGES = {
    "silence": (0.02, 0.09),
    "top_throttle": (-0.99, 1.0),
    "throttle_rise": (0.01, 100.0),
    "throttle_fall": (0.01, 100.0),
    "lock": (0.01, 1.0),
    "steering_rise": (0.01, 100.0),
    "steering_fall": (0.01, 100.0),
    "dead_zone": (0.0, 0.5),
}


class Keyboard(Pilot):
    """A person at a terminal.

    Args:
        config: Ramps of the keys and the longest silence; 30 repetitions a second are 0.033 s.
        source: Of the keys: a file descriptor.
        clock: Monotonic time [s].

    Raises:
        ValueError: The source is no terminal.
    """

    def __init__(
        self,
        config: Optional[HumanConfig] = None,
        source: Optional[int] = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._source = sys.stdin.fileno() if source is None else source
        if not os.isatty(self._source):
            raise ValueError(
                "pilot.kind='keyboard' needs a terminal: start the program in one (ssh -t), not "
                "from a service"
            )
        import termios  # not on every system
        import tty

        self._human = HumanInput(config, clock)
        self._left_to_policy = False
        self._termios = termios
        self._before: Any = termios.tcgetattr(self._source)
        tty.setcbreak(self._source)

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "Keyboard":
        """Makes a keyboard from settings: the fields of `HumanConfig`."""
        return cls(section(HumanConfig, settings, "pilot", RANGES))

    def command(self, dt: float) -> Optional[Command]:
        self._listen()
        command = self._human.command(dt)
        return None if self._left_to_policy or self._human.silent else command

    @property
    def hold_to_drive(self) -> bool:
        return self._before is not None and not self._human.silent

    def show(self, armed: bool, message: str) -> None:
        if not armed:
            back = HELP_BACK if self._human.config.two_way else ""
            sys.stderr.write(HELP + back + "\n")

    def close(self) -> None:
        if self._before is not None:
            self._termios.tcsetattr(self._source, self._termios.TCSADRAIN, self._before)
            self._before = None

    def _listen(self) -> None:
        """Takes the last of the keys that have come since the last call."""
        if self._before is None or not select.select([self._source], [], [], 0)[0]:
            return
        pressed = os.read(self._source, 1024).decode("utf-8", "replace")
        key = pressed[-3:] if pressed[-3:-1] == "\x1b[" else pressed[-1:]
        if key == POLICY_KEY:
            self._left_to_policy = True
            self._human.hear(Controls())
        elif key == REVERSE_KEY and self._human.config.two_way:
            self._left_to_policy = False
            self._human.hear(Controls(reverse=True))
        elif key in DRIVE_KEYS:
            self._left_to_policy = False
            throttle, steering = DRIVE_KEYS[key]
            self._human.hear(Controls("keyboard", throttle, steering))
        else:  # a neutral key, or one that means nothing
            self._left_to_policy = False
            self._human.hear(Controls(neutral=True, connected=False))
