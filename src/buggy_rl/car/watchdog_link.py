"""The loop's side of the watchdog: it is started, commanded, listened to and ended here."""

import json
import socket
import subprocess
import sys
from typing import Any, List, Mapping, Optional

from buggy_rl.car.clock import Clock
from buggy_rl.car.guard import GuardTimes
from buggy_rl.car.interfaces import Command, neutral_of
from buggy_rl.car.messages import STATES, CommandMessage, Report, read_report

SLOWEST_START = 10.0  # [s] until the first report: Python starts and the actuator is opened
SLOWEST_END = 2.0  # [s] from the last command until the process is gone
LONGEST_SILENCE = 0.1  # [s] without a report, although commands are sent every 10 ms


class Watchdog:
    """A watchdog process that is alive and has written neutral once.

    Args:
        actuator: `kind` and settings, as of the config.
        clock: The loop's.
        times: Of its guard.
        two_way: Whether no drive is throttle 0, not -1.

    Raises:
        OSError: It did not start; the message says what it wrote.
    """

    def __init__(
        self,
        actuator: Mapping[str, Any],
        clock: Clock,
        times: Optional[GuardTimes] = None,
        two_way: bool = False,
    ) -> None:
        self._clock, self._sequence, self._at_rest = clock, 0, neutral_of(two_way)
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        given = [json.dumps(dict(actuator)), json.dumps(list(times or GuardTimes()))]
        command = [sys.executable, "-m", "buggy_rl.car.watchdog", str(theirs.fileno())]
        self.process = subprocess.Popen(
            [*command, repr(clock.speed), *given, "two_way" if two_way else "one_way"],
            pass_fds=[theirs.fileno()],
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C in a terminal reaches the loop alone
        )
        theirs.close()
        self._wait_for_start()
        self._link.setblocking(False)
        self._heard, self._gone = clock.now(), False
        self._last: Optional[Report] = None
        self._arrived: List[Report] = []

    def _wait_for_start(self) -> None:
        self._link.settimeout(SLOWEST_START)
        try:
            started = bool(self._link.recv(1024))
        except socket.timeout:
            started = False
        if not started:
            self.process.kill()
            said = self.process.communicate()[1].decode(errors="replace").strip()
            raise OSError(f"the watchdog did not start: {said or 'it says nothing'}")

    def send(self, now: float, command: Command) -> None:
        """Sends a command of the time `now` [s]; one that cannot be sent shows in `dead`."""
        self._sequence += 1
        try:
            self._link.send(CommandMessage(self._sequence, now, *command).pack())
        except BlockingIOError:
            return  # it does not listen, so it does not report either: `dead` says so
        except OSError:
            self._gone = True

    def reports(self) -> List[Report]:
        """What was reported since the last call, oldest first."""
        self._receive()
        found, self._arrived = self._arrived, []
        return found

    def _receive(self) -> None:
        """Takes what has arrived."""
        count = len(self._arrived)
        while not self._gone:
            try:
                message = self._link.recv(1024)
            except BlockingIOError:
                break
            except OSError:
                message = b""
            if message:
                self._arrived.append(read_report(message))
            self._gone = not message
        if len(self._arrived) > count:
            self._heard, self._last = self._clock.now(), self._arrived[-1]

    @property
    def dead(self) -> str:
        """Why the drive has to end: the watchdog is gone or silent; empty if it is well."""
        if self._silence > LONGEST_SILENCE:
            self._receive()  # this process was asleep, and what was said meanwhile is waiting
        if self._gone:
            return "the watchdog is gone"
        if self._silence > LONGEST_SILENCE:
            return f"the watchdog has been silent for {self._silence:.2f} s"
        return ""

    @property
    def _silence(self) -> float:
        """Since it was last heard [s]."""
        return self._clock.now() - self._heard

    @property
    def trouble(self) -> str:
        """Why it keeps the wheels neutral; empty if it does not."""
        return STATES[self._last.state] if self._last is not None else ""

    def close(self) -> bool:
        """Ends it: neutral is written last; returns whether it said that this was done."""
        try:
            self._link.settimeout(SLOWEST_END)
            goodbye = CommandMessage(self._sequence + 1, self._clock.now(), *self._at_rest, 1)
            self._link.send(goodbye.pack())
        except OSError:
            self._gone = True
        self._link.close()
        try:
            status = self.process.wait(SLOWEST_END)
        except subprocess.TimeoutExpired:
            return False  # it goes on trying by itself
        finally:
            if self.process.stderr is not None:
                self.process.stderr.close()
        return status == 0
