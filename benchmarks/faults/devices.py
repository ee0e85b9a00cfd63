"""Drivers of the simulated car with faults inside: they hang, raise, dawdle or talk on demand.

A fault begins when `spoil` writes its name into a file beside the car's socket. The drivers run in
the processes of the runtime, which find this module by PYTHONPATH.
"""

import contextlib
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from buggy_rl.car.interfaces import Reading
from buggy_rl.car.simulated import SimulatedActuator, SimulatedSensor

HERE = "faults.devices"
IN_WATCHDOG = ("write_hangs", "watchdog_raises", "watchdog_talks")
IN_LOOP = ("loop_hangs", "loop_raises", "loop_slow", "loop_talks")
DAWDLES = 0.03  # [s] in each step: a loop of 25 Hz
TALK = "x" * 10_000  # characters to each of standard output and error with each call


def spoil(address: str, kind: str) -> None:
    """Begins a fault of the drivers of the car at this address; an empty kind ends it."""
    file = Path(address + ".spoilt")
    partial = file.with_suffix(".partial")
    partial.write_text(kind)
    partial.replace(file)


class Spoilt:
    """What a driver does before its own work."""

    def __init__(self, address: str) -> None:
        self._file = address + ".spoilt"

    def act(self) -> None:
        """Nothing, or the fault."""
        with contextlib.suppress(FileNotFoundError), open(self._file) as stream:
            kind = stream.read()
            if kind in ("write_hangs", "loop_hangs"):
                time.sleep(1e6)
            if kind in ("watchdog_raises", "loop_raises"):
                raise RuntimeError("the driver broke")
            if kind == "loop_slow":
                time.sleep(DAWDLES)
            if kind in ("watchdog_talks", "loop_talks"):
                sys.stdout.write(TALK)
                sys.stderr.write(TALK)
                with contextlib.suppress(BlockingIOError):  # as a C library's, which drops it
                    os.write(2, TALK.encode())


class SpoiltActuator(SimulatedActuator):
    """Of the watchdog; the loop's own handle is a sound one."""

    def __init__(self, address: str) -> None:
        super().__init__(address)
        self._spoilt = Spoilt(address + ".watchdog")

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "SpoiltActuator":
        return cls(settings["address"])

    def write(self, throttle: float, steering: float) -> None:
        self._spoilt.act()
        super().write(throttle, steering)


class SpoiltSensor(SimulatedSensor):
    """Of the loop."""

    def __init__(self, address: str) -> None:
        super().__init__(address)
        self._spoilt = Spoilt(address + ".loop")

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "SpoiltSensor":
        return cls(settings["address"])

    def readings(self) -> list[Reading]:
        self._spoilt.act()
        return super().readings()
