"""Faults, how each is injected, and what an injection is measured by."""

import contextlib
import math
import os
import random
import resource
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.car.interfaces import NEUTRAL, NO_DRIVE
from buggy_rl.simulated_car.launcher import SimulatedCar
from buggy_rl.simulated_car.physics import Entry
from buggy_rl.simulated_car.server import SENSOR_FAULTS
from faults.devices import IN_LOOP, IN_WATCHDOG, spoil

LASTS = 0.4  # [s] of a sensor fault: longer than the 0.25 s after which the car is disarmed
WATCHED = 0.45  # [s] after the begin of a fault; the button is pressed again later
LASTS_LONGER = {"pose_drifting": 0.8}  # [s]: a drift of 0.6 m/s shows after 0.36 s
SIZES = {  # [m], [s], [m/s]
    "jumping": (0.2, 2.0),
    "clock_step": (0.1, 2.0),
    "pose_drifting": (0.6, 2.0),
}
TAKES_WRITES_AGAIN = (0.01, 0.09)  # [s] a fault of the bus that ends while it matters
STOPPED, RUNS = 0.08, 0.02  # [s] of a process that is stopped again and again
TALKS = 0.2  # [s] of talking, by which 200 kB have filled every pipe, before the drive is ended


@dataclass(frozen=True)
class Target:
    """What faults are injected into."""

    car: SimulatedCar
    runtime: subprocess.Popen
    chance: random.Random

    @property
    def watchdog(self) -> int:
        """The process id of the runtime's only child."""
        pid = self.runtime.pid
        return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


Inject = Callable[[Target], float]


def _of_sensor(kind: str) -> Inject:
    def inject(target: Target) -> float:
        size = target.chance.uniform(*SIZES.get(kind, (0.0, 0.0)))
        if kind == "clock_step":
            size *= target.chance.choice((-1, 1))
        return target.car.spoil(kind, LASTS_LONGER.get(kind, LASTS), size)

    return inject


def _of_board(kind: str) -> Inject:
    """For `LASTS`; reactions count from its end: meanwhile only the board's hardware can stop."""
    return lambda target: target.car.spoil(kind, LASTS) + LASTS


def _bus(target: Target) -> float:
    return target.car.spoil("pwm", target.chance.uniform(*TAKES_WRITES_AGAIN))


def _signal(number: signal.Signals, to_watchdog: bool = False) -> Inject:
    def inject(target: Target) -> float:
        pid = target.watchdog if to_watchdog else target.runtime.pid
        begin = target.car.now
        os.kill(pid, number)
        return begin

    return inject


def _asleep(target: Target) -> float:
    begin = target.car.now
    target.runtime.send_signal(signal.SIGSTOP)
    time.sleep(LASTS)
    target.runtime.send_signal(signal.SIGCONT)
    return begin


def _stutters(to_watchdog: bool) -> Inject:
    def inject(target: Target) -> float:
        pid = target.watchdog if to_watchdog else target.runtime.pid
        begin = target.car.now
        with contextlib.suppress(ProcessLookupError):  # it was ended meanwhile, as it should be
            while target.car.now < begin + LASTS:
                os.kill(pid, signal.SIGSTOP)
                time.sleep(STOPPED)
                os.kill(pid, signal.SIGCONT)
                time.sleep(RUNS)
        return begin

    return inject


def _inside(kind: str) -> Inject:
    """A fault of a driver, in the process that it runs in."""
    place = ".watchdog" if kind in IN_WATCHDOG else ".loop"

    def inject(target: Target) -> float:
        begin = target.car.now
        spoil(target.car.address + place, kind)
        if kind in TALKING:  # it drives on, and has to stop when it is told to
            time.sleep(TALKS)
            begin = target.car.now
            target.runtime.send_signal(signal.SIGTERM)
        if kind not in ENDS:
            time.sleep(LASTS)
            spoil(target.car.address + place, "")
        return begin

    return inject


def _disk_full(target: Target) -> float:
    """No file of the runtime may grow any more: its next write to the recording fails."""
    begin = target.car.now
    resource.prlimit(target.runtime.pid, resource.RLIMIT_FSIZE, (1, 1))
    return begin


TALKING = ("watchdog_talks", "loop_talks")
FAULTS: dict[str, Inject] = {
    **{kind: _of_sensor(kind) for kind in SENSOR_FAULTS},
    "pwm_refused": _bus,
    "pwm_refused_long": _of_board("pwm"),
    "board_hangs": _of_board("hang"),
    "board_loses": _of_board("lose"),
    "loop_asleep": _asleep,
    "loop_stutters": _stutters(to_watchdog=False),
    "loop_killed": _signal(signal.SIGKILL),
    "sigterm": _signal(signal.SIGTERM),
    "sigint": _signal(signal.SIGINT),
    "sighup": _signal(signal.SIGHUP),
    "sigquit": _signal(signal.SIGQUIT),
    **{kind: _inside(kind) for kind in IN_LOOP},
    "disk_full": _disk_full,
    "watchdog_killed": _signal(signal.SIGKILL, to_watchdog=True),
    "watchdog_sigterm": _signal(signal.SIGTERM, to_watchdog=True),
    "watchdog_sighup": _signal(signal.SIGHUP, to_watchdog=True),
    "watchdog_sigquit": _signal(signal.SIGQUIT, to_watchdog=True),
    "watchdog_stopped": _signal(signal.SIGSTOP, to_watchdog=True),
    "watchdog_stutters": _stutters(to_watchdog=True),
    **{kind: _inside(kind) for kind in IN_WATCHDOG},
}
"""Fault -> injects it and returns the time [s] that reactions count from."""

SURVIVED = (
    *SENSOR_FAULTS,
    *("pwm_refused", "pwm_refused_long", "board_loses"),
    *("loop_asleep", "loop_stutters", "loop_slow", "watchdog_stutters"),
)
ENDS = tuple(fault for fault in FAULTS if fault not in SURVIVED)
"""Faults after which the runtime is gone."""


@dataclass(frozen=True)
class Reaction:
    """Of the wheels, by the simulated car's log."""

    begin: float
    """Of the fault [s]."""
    cut: float
    """Until no command drives any more [ms]."""
    neutral: float
    """Until no drive, wheels straight [ms]; infinite if never."""


def reaction(begin: float, entries: list[Entry]) -> Reaction:
    """From the log of the wheels since before `begin` [s].

    A command counts until the next one: the last that drives ends with its successor.
    """
    ends = [stamp for stamp, *_ in entries[1:]] + [math.inf]
    neutral = next((e[0] for e in entries if e[0] >= begin and e[1:] == NEUTRAL), math.inf)
    if entries[0][1:] == NEUTRAL and entries[0][0] <= begin:
        neutral = begin
    driving = [
        end
        for (stamp, throttle, _), end in zip(entries, ends, strict=True)
        if throttle > NO_DRIVE and stamp < neutral and end > begin
    ]
    cut = max(driving, default=begin)
    return Reaction(begin, 1e3 * (cut - begin), 1e3 * (neutral - begin))
