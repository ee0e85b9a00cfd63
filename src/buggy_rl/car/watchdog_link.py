"""The loop's side of the watchdog: it is started, commanded, listened to and ended here."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from typing import Any, List, Mapping, Optional

from buggy_rl.car.board_lock import hold, release
from buggy_rl.car.clock import Clock, Lateness
from buggy_rl.car.guard import GuardTimes
from buggy_rl.car.interfaces import ACTUATORS, Command, device_class, neutral_of
from buggy_rl.car.messages import (
    FAILING,
    REFUSED,
    STATES,
    CommandMessage,
    Report,
    read_report,
)

SLOWEST_START = 10.0  # [s] until the first report: Python starts and the actuator is opened
SLOWEST_END = 2.0  # [s] from the last command until the process is gone
LONGEST_SILENCE = 0.1  # [s] without a report, although commands are sent every 10 ms
KEPT = 2000  # bytes of what it wrote to standard error last


class Watchdog:
    """A watchdog process that is alive and has written neutral once.

    Args:
        actuator: `kind` and settings, as of the config.
        clock: The loop's.
        times: Of its guard.
        two_way: Whether no drive is throttle 0, not -1.

    Raises:
        OSError: It did not start; the message says what it wrote. Or another program has the board.
    """

    def __init__(
        self,
        actuator: Mapping[str, Any],
        clock: Clock,
        times: Optional[GuardTimes] = None,
        two_way: bool = False,
    ) -> None:
        self._clock, self._sequence, self._at_rest = clock, 0, neutral_of(two_way)
        self._period = (times or GuardTimes()).period
        kind, settings = device_class(ACTUATORS, actuator, "actuator")
        self._lock = kind.board(settings)
        held = hold(self._lock)
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        # The kernel takes the end of a thread for that of its process.
        parent = [os.getpid(), threading.current_thread() is threading.main_thread()]
        command = [sys.executable, "-m", "buggy_rl.car.watchdog", str(theirs.fileno())]
        given = [[held, self._lock], parent, clock.speed, dict(actuator), times or GuardTimes()]
        self.process = subprocess.Popen(
            [*command, *map(json.dumps, given), "two_way" if two_way else "one_way"],
            pass_fds=[fd for fd in (theirs.fileno(), held) if fd >= 0],
            stderr=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C in a terminal reaches the loop alone
        )
        theirs.close()
        self._wait_for_start()
        self._link.setblocking(False)
        self.refused = 0
        """Writes so far that the board did not take."""
        self.confirmed = REFUSED
        """What became of the last neutral: `TAKEN`, `READ_BACK`, or `REFUSED`."""
        self._heard, self._gone, self._said = clock.now(), False, b""
        self._late, self._asked = Lateness(self._period), 0.0
        self._stamp = self._heard
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
            self._link.close()
            release(self._lock)
            raise OSError(f"the watchdog did not start: {said or 'it says nothing'}")
        assert self.process.stderr is not None
        os.set_blocking(self.process.stderr.fileno(), False)

    def send(self, now: float, command: Command) -> None:
        """Sends a command of the time `now` [s]; one that cannot be sent shows in `dead`."""
        self._sequence += 1
        self._asked = self._asked or self._clock.now()  # the loop may have decided long before
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
                self._take(read_report(message))
            self._gone = not message
        if len(self._arrived) > count:
            self._heard, self._last = self._clock.now(), self._arrived[-1]

    def _take(self, report: Report) -> None:
        self._arrived.append(report)
        self.refused += report.taken == REFUSED
        if self._asked:
            self._late.add(self._gap(report.stamp))
        self._stamp, self._asked = report.stamp, 0.0

    def _gap(self, until: float) -> float:
        """Time between two reports [s], less that in which nothing was asked of the watchdog."""
        return max(0.0, min(until - self._stamp, until - self._asked + self._period))

    @property
    def dead(self) -> str:
        """Why the drive has to end: the watchdog is gone or silent; empty if it is well."""
        if self._silence > LONGEST_SILENCE:
            self._receive()  # this process was asleep, and what was said meanwhile is waiting
        if self._gone:
            return "the watchdog is gone" + self._last_words()
        if self._silence > LONGEST_SILENCE:
            return f"the watchdog has been silent for {self._silence:.2f} s"
        return ""

    @property
    def late(self) -> str:
        """Why it cannot be driven by, although it is not silent; call `reports` before."""
        gap = self._gap(self._clock.now()) if self._asked else 0.0
        return "the watchdog is late again and again" if self._late.too_slow(gap) else ""

    @property
    def _silence(self) -> float:
        """Time since the watchdog was last heard [s]."""
        return self._clock.now() - self._heard

    @property
    def trouble(self) -> str:
        """Why it keeps the wheels neutral; empty if it does not."""
        return STATES[self._last.state] if self._last is not None else ""

    @property
    def failing(self) -> bool:
        """The board does not take what it writes."""
        return self._last is not None and self._last.state == FAILING

    def listen(self) -> None:
        """Takes what it wrote to standard error, whose pipe never fills up so."""
        if self.process.stderr is not None and not self.process.stderr.closed:
            with contextlib.suppress(OSError):
                chunk = os.read(self.process.stderr.fileno(), 65536)
                self._said = (self._said + chunk)[-KEPT:]

    def _last_words(self) -> str:
        self.listen()
        lines = self._said.decode(errors="replace").split("\n")
        said = next((line for line in reversed(lines) if line.strip()), "")
        return f": {said}" if said else ""

    def close(self) -> bool:
        """Ends it: neutral is written last; returns whether it said that this was done.

        One that says nothing is killed, so that nobody writes after the loop has; one that says
        that the board takes nothing goes on trying by itself.
        """
        dead = self.dead
        if not dead:
            self._say_goodbye()
        self._link.close()
        if self.confirmed or (not dead and self.trying):
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(SLOWEST_END)
        else:
            self.process.kill()
        self.listen()
        if self.process.stderr is not None:
            self.process.stderr.close()
        release(self._lock)
        return bool(self.confirmed)

    @property
    def trying(self) -> bool:
        """Whether it goes on trying to write neutral to a board that takes nothing."""
        return self.failing and self.process.poll() is None

    def _say_goodbye(self) -> None:
        """Waits for the report of the last neutral, for as long as it reports anything."""
        last = self._sequence + 1
        goodbye = CommandMessage(last, self._clock.now(), *self._at_rest, last=1)
        try:
            self._link.send(goodbye.pack())
        except OSError:  # gone, or so full that it does not listen
            self._gone = True
        end = time.monotonic() + SLOWEST_END
        while not self._gone and self._silence <= LONGEST_SILENCE and time.monotonic() < end:
            for report in self.reports():
                if report.sequence >= last and report.taken:
                    self.confirmed = report.taken
                    return
            time.sleep(0.0005)
