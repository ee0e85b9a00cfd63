"""The watchdog: a process of its own that holds the actuator and outlives the loop.

`python -m buggy_rl.car.watchdog FD SPEED ACTUATOR TIMES WAYS` is started by
`watchdog_link.Watchdog`. It writes what the loop commands, and neutral when it hears nothing fresh,
when the loop's end of the socket closes and when it is told to stop. It imports neither numpy nor
the policy.
"""

import contextlib
import json
import select
import signal
import socket
import sys
from typing import List

from buggy_rl.car.clock import Clock
from buggy_rl.car.devices import ACTUATORS, make_device
from buggy_rl.car.guard import Guard, GuardTimes
from buggy_rl.car.interfaces import neutral_of
from buggy_rl.car.messages import read_command
from buggy_rl.car.priority import WATCHDOG, take_priority

LINGER = 0.5  # [s] that neutral is written for after the loop died: the board may miss one
GIVE_UP = 60.0  # [s] after which a board that takes no command is left to its hardware failsafe
LONGEST_WAIT = 0.02  # [s] between two looks at the signals


class WatchdogProcess:
    """Couples the socket, the guard and the actuator.

    Args:
        link: The watchdog's end of a `SOCK_SEQPACKET` pair.
        guard: Writes to the actuator.
        clock: The same as the loop's.
    """

    def __init__(self, link: socket.socket, guard: Guard, clock: Clock) -> None:
        self._link, self._clock, self.guard = link, clock, guard
        self._over, self._ended = False, False

    def run(self) -> int:
        """Until the loop is gone and the wheels are neutral; returns the exit status."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop ends the drive, then this
        signal.signal(signal.SIGTERM, lambda *_: self._end())
        self._link.setblocking(False)
        while not self._ended:
            wait = min(self.guard.wait(self._clock.now()) / self._clock.speed, LONGEST_WAIT)
            if select.select([self._link], [], [], wait)[0]:
                self._hear()
            self._write()
        return self._leave()

    def _end(self) -> None:
        self._ended = True

    def _hear(self) -> None:
        """Takes all that has arrived."""
        while not self._ended:
            try:
                message = self._link.recv(1024)
            except BlockingIOError:
                return
            except OSError:
                message = b""
            if not message:
                return self._end()
            command = read_command(message)
            if command.last:
                self._over = True
                return self._end()
            self.guard.hear(command, self._clock.now())

    def _write(self) -> bool:
        """Does what is due and reports it; returns whether the actuator took it."""
        done = self.guard.act(self._clock.now())
        if done is None:
            return False
        report = self.guard.report(self._clock.now(), *done)
        with contextlib.suppress(OSError):  # of a loop that is gone or asleep, seen elsewhere
            self._link.send(report.pack())
        return done[1]

    def _leave(self) -> int:
        """Writes neutral until the actuator took it, and on for a while after a death."""
        begin, taken = self._clock.now(), False
        self.guard.silence()
        while True:
            taken = self._write() or taken
            since = self._clock.now() - begin
            if taken and (self._over or since > LINGER):
                return 0
            if since > GIVE_UP:
                return 1
            self._clock.sleep(self.guard.wait(self._clock.now()))


def main(arguments: List[str]) -> int:
    """The process."""
    descriptor, speed, about, times, two_way = arguments
    link = socket.socket(fileno=int(descriptor))
    try:
        actuator = make_device(ACTUATORS, json.loads(about), "actuator")
    except (ValueError, OSError, ImportError) as error:
        sys.stderr.write(f"{error}\n")
        return 2
    clock = Clock(float(speed))
    take_priority(WATCHDOG)
    try:
        at_rest = neutral_of(two_way == "two_way")
        guard = Guard(actuator, GuardTimes(*json.loads(times)), clock.now(), at_rest)
        return WatchdogProcess(link, guard, clock).run()
    finally:
        actuator.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
