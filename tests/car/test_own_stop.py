"""The loop stops the car alone, whatever becomes of its watchdog; the watchdog stops it alone."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time

import pytest

from buggy_rl.car import drive as driving
from buggy_rl.car.drive import make_config
from buggy_rl.car.interfaces import NEUTRAL
from buggy_rl.car.watchdog_link import Watchdog
from tests.car.test_loop import about, log  # noqa: F401  (fixtures)
from tests.car.test_watchdog import LOOP, FileActuator

pytestmark = pytest.mark.timeout(120)  # a car that nothing stops drives for ever
SLACK = 0.06  # [s] granted beyond the rules to a machine that is busy with other tests
TIMES = 4  # drives at most until one is in time: other work adds to a time, and never takes away


class BrokenInWatchdog(FileActuator):
    """Has a fault, named by a file, in every process but the loop's."""

    def __init__(self, path, loop):
        super().__init__(path)
        self.loop = loop

    @classmethod
    def from_dict(cls, settings):
        return cls(settings["path"], settings["loop"])

    def write(self, throttle, steering):
        kind = ""
        if os.path.exists(self.path + ".fault") and os.getpid() != self.loop:
            kind = pathlib.Path(self.path + ".fault").read_text()
        if kind == "hang":
            time.sleep(1000)
        if kind == "raise":
            raise RuntimeError("the driver broke")
        if kind == "exit":
            os._exit(0)
        if kind == "talk":
            sys.stderr.write("x" * 100_000)
            sys.stdout.write("x" * 100_000)
        super().write(throttle, steering)


class Shared(BrokenInWatchdog):
    """Of a board that two processes can open."""

    @classmethod
    def second(cls, settings):
        return cls.from_dict(settings)


@pytest.fixture
def drive_until(about, log, monkeypatch):  # noqa: F811
    """Drives, lets something happen to the watchdog; gives the summary, and seconds to neutral.

    With `within`, drives again while neutral took longer, at most `TIMES` times.
    """
    made = []

    class Seen(Watchdog):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(self)

    monkeypatch.setattr(driving, "Watchdog", Seen)

    def drive(happens, kind=Shared, seconds=30.0, within=float("inf")):
        for _ in range(TIMES):
            log.path.unlink(missing_ok=True)
            log.path.with_name("commands.fault").unlink(missing_ok=True)
            summary, took = once(happens, kind, seconds)
            if took < within:
                break
        return summary, took

    def once(happens, kind, seconds):
        config = {
            **about,
            "actuator": {
                "kind": f"{__name__}:{kind.__name__}",
                "path": str(log.path),
                "loop": os.getpid(),
            },
            "safety": {"max_seconds": seconds},
        }
        begun = []

        def later():
            end = time.monotonic() + 20
            while not (log.path.exists() and any(c[1] > -1 for c in log.commands())):
                assert time.monotonic() < end, "it does not drive"
                time.sleep(0.01)
            time.sleep(0.2)
            begun.append(time.monotonic())
            happens(made[-1].process)

        thread = threading.Thread(target=later)
        thread.start()
        summary = driving.drive_car(make_config(config), {}, [].append)
        thread.join()
        last = max(t for t, throttle, _ in log.commands() if throttle > -1)
        neutral = min(t for t, *command in log.commands() if t > last and command == [-1.0, 0.0])
        assert log.last() == NEUTRAL
        return summary, neutral - begun[0]

    return drive


SECONDS = {
    signal.SIGHUP: 0.02,
    signal.SIGQUIT: 0.02,
    signal.SIGTERM: 0.02,
    signal.SIGUSR1: 0.02,
    signal.SIGKILL: 0.05,
    signal.SIGSTOP: 0.15,
}
# Caught, not caught, no end at all; the rest of the pairs are slow.
DISTINCT = {Shared: (signal.SIGTERM, signal.SIGKILL, signal.SIGSTOP), BrokenInWatchdog: ()}


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        pytest.param(number, kind, marks=[pytest.mark.slow] * (number not in DISTINCT[kind]))
        for kind in (Shared, BrokenInWatchdog)
        for number in SECONDS
    ],
    ids=lambda value: getattr(value, "name", value.__name__ if callable(value) else ""),
)
def test_a_signal_to_the_watchdog_stops_the_car(drive_until, number, kind):
    within = SECONDS[number] + SLACK
    summary, took = drive_until(lambda process: process.send_signal(number), kind, within=within)
    assert took < within
    assert summary.neutral_confirmed
    assert "watchdog" in summary.stopped


@pytest.mark.parametrize("kind", [Shared, pytest.param(BrokenInWatchdog, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("fault", "seconds"), [("hang", 0.15), ("raise", 0.1), ("exit", 0.1)])
def test_a_driver_that_breaks_in_the_watchdog_stops_the_car(
    drive_until,
    log,  # noqa: F811
    fault,
    seconds,
    kind,
):
    file = log.path.with_name("commands.fault")
    within = seconds + SLACK
    summary, took = drive_until(lambda process: file.write_text(fault), kind, within=within)
    assert took < within
    assert summary.by_loop
    assert summary.neutral_confirmed
    if fault == "raise":
        assert "the driver broke" in summary.stopped


@pytest.mark.parametrize("kind", [Shared, pytest.param(BrokenInWatchdog, marks=pytest.mark.slow)])
def test_a_watchdog_that_is_stopped_again_and_again_stops_the_car(drive_until, kind):
    def stutter(process):
        for _ in range(5):
            if process.poll() is None:
                process.send_signal(signal.SIGSTOP)
                time.sleep(0.08)
                process.send_signal(signal.SIGCONT)
                time.sleep(0.02)

    within = 0.15 + SLACK
    summary, took = drive_until(stutter, kind, seconds=1.5, within=within)
    assert took < within
    assert summary.neutral_confirmed
    ended = "late again and again" in summary.stopped
    assert ended == (kind is BrokenInWatchdog)  # which the loop cannot open beside it


def test_a_driver_that_fills_standard_error_does_not_hold_up_the_watchdog(drive_until, log):  # noqa: F811
    file = log.path.with_name("commands.fault")
    summary, _ = drive_until(lambda process: file.write_text("talk"), seconds=1.0)
    assert summary.stopped == "1 s of driving are over"
    assert summary.neutral_confirmed
    assert not summary.by_loop


class Refused(Shared):
    """Takes nothing from the watchdog once the file is there."""

    def write(self, throttle, steering):
        if os.path.exists(self.path + ".fault") and os.getpid() != self.loop:
            raise OSError("the connection is reset")
        FileActuator.write(self, throttle, steering)


def test_a_connection_that_broke_in_the_watchdog_alone_is_no_broken_board(drive_until, log):  # noqa: F811
    file = log.path.with_name("commands.fault")

    def breaks(process):
        file.touch()
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGTERM)

    within = 0.03 + SLACK
    summary, took = drive_until(breaks, Refused, within=within)
    assert took < within
    assert summary.refused > 10
    assert not summary.neutral_confirmed  # by the watchdog, which goes on trying


@pytest.mark.parametrize(
    "number", [signal.SIGHUP, signal.SIGQUIT, signal.SIGKILL, signal.SIGSTOP], ids=lambda n: n.name
)
def test_the_watchdog_stops_the_car_of_a_loop_that_gets_a_signal(log, number):  # noqa: F811
    within = 0.1 + SLACK
    for _ in range(TIMES):
        log.path.unlink(missing_ok=True)
        took = seconds_to_neutral(log, number)
        if took < within:
            break
    assert took < within


def seconds_to_neutral(log, number):  # noqa: F811
    """From a signal to the loop to the first neutral command."""
    loop = subprocess.Popen([sys.executable, "-c", LOOP, json.dumps(log.about)])
    try:
        end = time.monotonic() + 60  # of a busy machine: two interpreters start
        while not (log.path.exists() and log.path.read_text() and log.last() == (0.2, 0.1)):
            assert time.monotonic() < end
            time.sleep(0.01)
        begin = time.monotonic()
        loop.send_signal(number)
        log.wait_for(NEUTRAL)
        first = next(t for t, *command in log.commands() if t > begin and tuple(command) == NEUTRAL)
        return first - begin
    finally:
        loop.kill()
        loop.wait(20)


def test_a_disk_that_hangs_when_the_note_is_written_does_not_hold_up_neutral(
    about,  # noqa: F811
    log,  # noqa: F811
    monkeypatch,
):
    class BrokenError(Exception):
        pass

    def raises(self, now):
        raise BrokenError

    written = []
    monkeypatch.setattr(driving, "write_note", lambda *_: written.append(log.path.exists()
                        and log.last() == NEUTRAL and len(log.commands()) > 1))  # fmt: skip
    monkeypatch.setattr(driving.Loop, "_step", raises)
    with pytest.raises(BrokenError):
        driving.drive_car(make_config(about), {}, [].append)
    assert written[-1]  # neutral came before the note


def test_a_note_that_cannot_be_written_does_not_hide_how_the_drive_ended(about, monkeypatch):  # noqa: F811
    calls, write = [], driving.write_note

    def full(path, content):
        calls.append(path)
        if len(calls) > 1:
            raise OSError(28, "No space left on device")
        write(path, content)

    monkeypatch.setattr(driving, "write_note", full)
    said = []
    summary = driving.drive_car(make_config(about), {}, said.append)
    assert summary.neutral_confirmed
    assert "could not be written: [Errno 28] No space left" in said[-1]
