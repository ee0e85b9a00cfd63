"""The loop with real parts: a watchdog process, a recorder, and a car of a few lines."""

import os
import signal
import threading
import time

import pandas as pd
import pytest

from buggy_rl.car.drive import drive_car, make_config
from buggy_rl.car.interfaces import Reading, Sensor
from buggy_rl.car.path import Pursuit
from tests.car.test_watchdog import FileActuator, Log

pytestmark = pytest.mark.timeout(120)  # a car that never arms drives for ever


class Rolling(Sensor):
    """Drives along x at 1 m/s, measured whenever it is asked."""

    def __init__(self):
        self.begin = time.monotonic()

    @classmethod
    def from_dict(cls, settings):
        return cls()

    def latest(self):
        now = time.monotonic()
        return Reading(now, (now - self.begin, 1e-4 * (now % 0.01), 0.0), (1.0, 0.0, 0.0))


class DyingSensor(Rolling):
    """Raises in the middle of a drive."""

    def __init__(self):
        super().__init__()
        self.count = 0

    def latest(self):
        self.count += 1
        if self.count > 40:
            raise RuntimeError("the driver of the sensor broke")
        return super().latest()


@pytest.fixture
def log(tmp_path):
    return Log(tmp_path)


@pytest.fixture
def about(tmp_path, log):
    (tmp_path / "path.csv").write_text("x,y\n0,0\n1,0\n2,0\n1000000,0\n")
    return {
        "sensor": {"kind": "tests.car.test_loop:Rolling"},
        "actuator": {**log.about, "kind": f"{FileActuator.__module__}:FileActuator"},
        "pilot": {"kind": "scripted", "press_after": 0.15},
        "policy": {"kind": "pursuit", "path": str(tmp_path / "path.csv"), "speed": 1.2},
        "output": str(tmp_path / "drives"),
        "geofence": "none",
        "safety": {"max_seconds": 0.3},
    }


def run(about):
    said = []
    return drive_car(make_config(about), {}, said.append), said


def driven(log):
    return any(throttle > -1 for _, throttle, _ in log.commands())


def test_a_drive_ends_after_its_time_with_neutral_last(about, log):
    summary, said = run(about)
    assert summary.stopped == "0.3 s of driving are over"
    assert "armed" in said
    assert driven(log)
    assert log.last() == (-1.0, 0.0)
    assert summary.neutral_confirmed
    assert 40 <= summary.steps <= 60  # 0.15 s to the press, 0.3 s of driving, some to disarm


def test_its_rows_say_who_drove_and_when_the_command_was_taken(about, log):
    summary, _ = run(about)
    table = pd.read_csv(summary.recording)
    assert len(table) == summary.rows > 0.9 * summary.steps - 2
    assert set(table["source"]) >= {"neutral", "policy"}
    taken = {(round(a, 6), round(b, 6)) for _, a, b in log.commands()}
    rows = {(round(a, 6), round(b, 6)) for a, b in table[["throttle", "steering"]].to_numpy()}
    assert rows <= taken
    known = table.dropna()
    assert (known["command_t"] <= known["t"]).all()


def test_an_exception_in_the_loop_leaves_neutral_and_a_recording(about, log):
    with pytest.raises(RuntimeError, match="sensor broke"):
        run({**about, "sensor": {"kind": "tests.car.test_loop:DyingSensor"}})
    assert driven(log)
    assert log.last() == (-1.0, 0.0)
    files = os.listdir(about["output"])
    assert sorted(files) == ["drive_00.csv", "drive_00.json"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_neutral_last(about, log, number):
    timer = threading.Timer(0.5, os.kill, (os.getpid(), number))
    timer.start()
    summary, _ = run({**about, "safety": {"max_seconds": 30.0}})
    timer.join()
    assert summary.stopped == number.name
    assert log.last() == (-1.0, 0.0)


def test_a_policy_that_fails_leaves_neutral(about, log, monkeypatch):
    def broken(self, pose, velocity):
        raise FloatingPointError("overflow")

    monkeypatch.setattr(Pursuit, "step", broken)
    with pytest.raises(FloatingPointError):
        run(about)
    assert log.last() == (-1.0, 0.0)


def test_nobody_is_left_behind(about, log):
    before = threading.active_count()
    run(about)
    assert threading.active_count() == before
