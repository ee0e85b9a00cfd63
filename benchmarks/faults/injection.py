"""Faults, how each is injected, and what an injection is measured by."""

import math
import os
import random
import signal
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from buggy_rl.car.interfaces import NEUTRAL, NO_DRIVE
from buggy_rl.simulated_car.launcher import SimulatedCar
from buggy_rl.simulated_car.sensor_faults import SENSOR_FAULTS
from buggy_rl.simulated_car.wheels import Entry

LASTS = 0.4  # [s] of a sensor fault: longer than the 0.25 s after which the car is disarmed
WATCHED = 0.45  # [s] after the begin of a fault; the button is pressed again later
SIZES = {"jumping": (0.2, 2.0), "clock_step": (0.1, 2.0)}  # [m], [s]
TAKES_WRITES_AGAIN = (0.01, 0.09)  # [s] a fault of the bus that ends while it matters


@dataclass(frozen=True)
class Target:
    """What faults are injected into."""

    car: SimulatedCar
    runtime: subprocess.Popen
    chance: random.Random


def _of_sensor(kind: str) -> Callable[[Target], float]:
    def inject(target: Target) -> float:
        size = target.chance.uniform(*SIZES.get(kind, (0.0, 0.0)))
        if kind == "clock_step":
            size *= target.chance.choice((-1, 1))
        return target.car.spoil(kind, LASTS, size)

    return inject


def _bus(target: Target) -> float:
    return target.car.spoil("pwm", target.chance.uniform(*TAKES_WRITES_AGAIN))


def _bus_long(target: Target) -> float:
    return target.car.spoil("pwm", LASTS) + LASTS


def _signal(number: signal.Signals) -> Callable[[Target], float]:
    def inject(target: Target) -> float:
        begin = target.car.now
        target.runtime.send_signal(number)
        return begin

    return inject


def _asleep(target: Target) -> float:
    begin = target.car.now
    target.runtime.send_signal(signal.SIGSTOP)
    time.sleep(LASTS)
    target.runtime.send_signal(signal.SIGCONT)
    return begin


def _watchdog_killed(target: Target) -> float:
    pid = target.runtime.pid
    child = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    begin = target.car.now
    os.kill(int(child[0]), signal.SIGKILL)
    return begin


FAULTS: dict[str, Callable[[Target], float]] = {
    **{kind: _of_sensor(kind) for kind in SENSOR_FAULTS},
    "pwm_refused": _bus,
    "pwm_refused_long": _bus_long,
    "loop_asleep": _asleep,
    "loop_killed": _signal(signal.SIGKILL),
    "sigterm": _signal(signal.SIGTERM),
    "sigint": _signal(signal.SIGINT),
    "watchdog_killed": _watchdog_killed,
}
"""Fault -> injects it and returns the time [s] that reactions count from."""

ENDS = ("loop_killed", "sigterm", "sigint", "watchdog_killed")
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
