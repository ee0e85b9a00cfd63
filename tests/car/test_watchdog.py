"""The watchdog as a process: it outlives the loop and writes neutral, whatever ends it."""

import signal
import subprocess
import sys
import time

import pytest

from buggy_rl.car.clock import Clock
from buggy_rl.car.interfaces import Actuator
from buggy_rl.car.watchdog_link import Watchdog


class FileActuator(Actuator):
    """Appends each command to a file; refuses while a file of that name with .refuse exists."""

    def __init__(self, path):
        self.path = path

    @classmethod
    def from_dict(cls, settings):
        return cls(settings["path"])

    def write(self, throttle, steering):
        try:
            open(self.path + ".refuse").close()
        except FileNotFoundError:
            with open(self.path, "a") as stream:
                stream.write(f"{time.monotonic()} {throttle} {steering}\n")
            return
        raise OSError("refused")


class Log:
    """What a watchdog's actuator took."""

    def __init__(self, folder):
        self.path = folder / "commands"
        self.about = {"kind": "tests.car.test_watchdog:FileActuator", "path": str(self.path)}

    def commands(self):
        lines = self.path.read_text().split("\n")[:-1]
        return [tuple(map(float, line.split())) for line in lines]

    def last(self):
        return self.commands()[-1][1:]

    def wait_for(self, command, seconds=5.0):
        end = time.monotonic() + seconds
        while self.last() != command:
            assert time.monotonic() < end, f"{self.last()} is not {command}"
            time.sleep(0.002)


@pytest.fixture
def log(tmp_path):
    return Log(tmp_path)


def drive(watchdog, log, command=(0.2, 0.1)):
    """Sends a command until it was written."""
    end = time.monotonic() + 5.0
    while log.last() != command and time.monotonic() < end:
        watchdog.send(time.monotonic(), command)
        watchdog.reports()
        time.sleep(0.005)
    assert log.last() == command


def test_it_writes_neutral_first_and_last(log):
    watchdog = Watchdog(log.about, Clock())
    assert log.last() == (-1.0, 0.0)
    drive(watchdog, log)
    assert watchdog.close()
    assert log.last() == (-1.0, 0.0)
    assert watchdog.process.returncode == 0


def test_a_loop_that_falls_silent_gets_neutral_after_100_ms(log):
    watchdog = Watchdog(log.about, Clock())
    drive(watchdog, log)
    log.wait_for((-1.0, 0.0))
    stamps = [t for t, *command in log.commands() if command == [0.2, 0.1]]
    first = next(t for t, *c in log.commands() if t > stamps[-1])
    assert first - stamps[-1] >= 0.09
    assert [r.state for r in watchdog.reports()][-1] != 0
    assert watchdog.trouble == "no fresh command reached the watchdog"
    watchdog.close()


LOOP = """
import signal, sys, time, json
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # and one behind nohup these
signal.signal(signal.SIGQUIT, signal.SIG_DFL)
from buggy_rl.car.clock import Clock
from buggy_rl.car.watchdog_link import Watchdog
watchdog = Watchdog(json.loads(sys.argv[1]), Clock())
while True:
    watchdog.send(time.monotonic(), (0.2, 0.1))
    watchdog.reports()
    time.sleep(0.005)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_the_death_of_the_loop_is_neutral(log, number):
    import json

    loop = subprocess.Popen([sys.executable, "-c", LOOP, json.dumps(log.about)])
    try:
        end = time.monotonic() + 60  # of a busy machine: two interpreters start
        while not (log.path.exists() and log.path.read_text() and log.last() == (0.2, 0.1)):
            assert time.monotonic() < end
            time.sleep(0.01)
        loop.send_signal(number)
        loop.wait(20)
        log.wait_for((-1.0, 0.0))
    finally:
        loop.kill()
        loop.wait()


def test_a_refusing_actuator_is_told_and_gets_neutral_when_it_takes_commands_again(log):
    watchdog = Watchdog(log.about, Clock())
    drive(watchdog, log)
    refuse = log.path.with_name("commands.refuse")
    refuse.touch()
    end = time.monotonic() + 5.0
    while watchdog.trouble != "the actuator does not take commands" and time.monotonic() < end:
        watchdog.send(time.monotonic(), (0.2, 0.1))
        watchdog.reports()
        time.sleep(0.005)
    assert watchdog.trouble == "the actuator does not take commands"
    refuse.unlink()
    log.wait_for((-1.0, 0.0))
    watchdog.close()


def test_the_loop_is_told_when_the_watchdog_died(log):
    watchdog = Watchdog(log.about, Clock())
    assert watchdog.dead == ""
    watchdog.process.kill()
    watchdog.process.wait()
    watchdog.reports()
    assert watchdog.dead == "the watchdog is gone"
    assert not watchdog.close()


def test_a_watchdog_that_is_stopped_is_noticed(log):
    watchdog = Watchdog(log.about, Clock())
    watchdog.process.send_signal(signal.SIGSTOP)
    time.sleep(0.15)
    watchdog.reports()
    assert "silent" in watchdog.dead
    watchdog.process.kill()
    watchdog.close()


def test_an_actuator_that_cannot_be_opened_is_said():
    about = {"kind": "simulated", "address": "/nowhere"}
    with pytest.raises(OSError, match="no simulated car listens at /nowhere"):
        Watchdog(about, Clock())


def test_a_loop_that_slept_does_not_call_the_watchdog_silent_and_loses_no_report(log):
    watchdog = Watchdog(log.about, Clock())
    drive(watchdog, log)
    watchdog.reports()
    time.sleep(0.3)  # meanwhile it writes neutral, and reports
    assert watchdog.dead == ""
    assert (-1.0, 0.0) in [(r.throttle, r.steering) for r in watchdog.reports()]
    watchdog.close()


def test_a_watchdog_that_hangs_is_called_silent(log):
    watchdog = Watchdog(log.about, Clock())
    drive(watchdog, log)
    watchdog.process.send_signal(signal.SIGSTOP)
    watchdog.reports()
    time.sleep(0.3)
    assert "silent for 0.3" in watchdog.dead
    watchdog.process.send_signal(signal.SIGCONT)
    watchdog.close()


def test_a_loop_that_is_slow_does_not_call_the_watchdog_late(log):
    watchdog = Watchdog(log.about, Clock())
    for _ in range(30):
        decided = time.monotonic()
        time.sleep(0.03)  # a sensor that takes its time
        watchdog.reports()
        watchdog.send(decided, (-1.0, 0.0))
        assert not watchdog.late
    watchdog.close()
