"""The watchdog: a process of its own that holds the actuator and outlives the loop.

`python -m buggy_rl.car.watchdog FD LOCK PARENT SPEED ACTUATOR TIMES WAYS` is started by
`watchdog_link.Watchdog`. It writes what the loop commands, and neutral when it hears nothing fresh,
when the loop's end of the socket closes, when the loop's process is gone, when a signal or an error
of its own ends it and when it is told to stop. It imports neither numpy nor the policy.
"""

import contextlib
import json
import select
import signal
import socket
import sys
import traceback
from typing import List, Tuple

from buggy_rl.car.board_lock import inherit
from buggy_rl.car.clock import WATCHDOG, Clock, take_priority
from buggy_rl.car.guard import Guard, GuardTimes
from buggy_rl.car.interfaces import ACTUATORS, Actuator, Command, make_device, neutral_of
from buggy_rl.car.messages import read_command
from buggy_rl.car.output import UnblockedOutput
from buggy_rl.car.own_stop import LINGER, keep_neutral
from buggy_rl.car.stopping import Parent, StopSignals

LONGEST_WAIT = 0.02  # [s] between two looks at the signals and at the parent
LAST_TRIES = 5  # to write neutral with a driver that raises what no driver should


class WatchdogProcess:
    """Couples the socket, the guard and the actuator.

    Args:
        link: The watchdog's end of a `SOCK_SEQPACKET` pair.
        guard: Writes to the actuator.
        clock: The same as the loop's.
        signals: Those that end it.
        parent: The loop's process.
    """

    def __init__(
        self,
        link: socket.socket,
        guard: Guard,
        clock: Clock,
        signals: StopSignals,
        parent: Parent,
    ) -> None:
        self._link, self._clock, self.guard = link, clock, guard
        self._signals, self._parent = signals, parent
        self._over, self._ended = 0, False

    def run(self) -> int:
        """Serves until the loop is gone and the wheels are neutral; returns the exit status."""
        self._link.setblocking(False)
        said = ""
        try:
            self._serve()
        except Exception as error:  # said after neutral
            said = f"{error!r}\n"
        linger = 0.0 if self._over else LINGER
        done = keep_neutral(self.guard, self._clock, linger, self._tell, self._over)
        sys.stderr.write(said)
        return 1 if said or not done else 0

    def _serve(self) -> None:
        """Serves until something ends it."""
        while not self._ended:
            wait = min(self.guard.wait(self._clock.now()) / self._clock.speed, LONGEST_WAIT)
            if select.select([self._link], [], [], wait)[0]:
                self._hear()
            self._ended = self._ended or bool(self._signals.caught) or self._parent.gone
            done = None if self._ended else self.guard.act(self._clock.now())
            if done is not None:
                self._tell(done)

    def _hear(self) -> None:
        """Takes all that has arrived."""
        while not self._ended:
            try:
                message = self._link.recv(1024)
            except BlockingIOError:
                return
            except OSError:
                message = b""
            self._ended = not message
            if message:
                command = read_command(message)
                self._ended = bool(command.last)
                if command.last:
                    self._over = command.sequence
                else:
                    self.guard.hear(command, self._clock.now())

    def _tell(self, done: Tuple[Command, int]) -> None:
        """Reports what was written."""
        report = self.guard.report(self._clock.now(), *done)
        with contextlib.suppress(OSError):  # of a loop that is gone or asleep, seen elsewhere
            self._link.send(report.pack())


def main(arguments: List[str]) -> int:
    """Runs the process of the watchdog; returns its exit status."""
    descriptor, lock, parent, speed, about, times, two_way = arguments
    with StopSignals(ignored=(signal.SIGINT,)) as signals:  # at SIGINT the loop ends the drive
        link = socket.socket(fileno=int(descriptor))
        number, file = json.loads(lock)
        inherit(file, number)
        with UnblockedOutput():
            family = Parent(*json.loads(parent))
            try:
                actuator = make_device(ACTUATORS, json.loads(about), "actuator")
            except (ValueError, OSError, ImportError) as error:
                sys.stderr.write(f"{error}\n")
                return 2
            clock, at_rest = Clock(float(speed)), neutral_of(two_way == "two_way")
            take_priority(WATCHDOG)
            try:
                guard = Guard(actuator, GuardTimes(*json.loads(times)), clock.now(), at_rest)
                return WatchdogProcess(link, guard, clock, signals, family).run()
            except BaseException as error:
                return _broken(actuator, at_rest, link, error)
            finally:
                with contextlib.suppress(Exception):  # neutral is written: nothing is left to do
                    actuator.close()


def _broken(actuator: Actuator, at_rest: Command, link: socket.socket, error: BaseException) -> int:
    """Neutral, if it can be written at all; then the loop hears at once that it is alone."""
    for _ in range(LAST_TRIES):
        with contextlib.suppress(Exception):
            actuator.write(*at_rest)
            break
    sys.stderr.write(f"{error!r}\n")
    link.close()
    traceback.print_exc()  # takes a while: it reads the source
    return 3


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
